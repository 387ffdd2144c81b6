"""The manifest of a recording: its origin, and the corrections of its channels."""

from typing import TypedDict

from pydantic import JsonValue

JsonFields = dict[str, JsonValue]  # the fields of a frozen class of another package


class NoiseGain(TypedDict):
    """Factor by which the white noise of a channel increased by its correction."""

    effort: float
    velocity: float


class Channels(TypedDict, total=False):
    """`timing` (`ChannelTiming`, s) and `noise_gain` where the channels were `corrected`."""

    corrected: bool
    timing: JsonFields
    noise_gain: NoiseGain


class Facts(TypedDict, total=False):
    """For a run of this process: its numbers, sweep, drives (`AxisIdentity`) and set-points (`SetPointTiming`).

    For a stream left by another process: `campaign` and `sweep`. For an imported bundle: `robot` and sweep.
    `cause`: reason why a recording is partial.
    """

    robot: str
    campaign: int
    sweep: int
    campaign_id: int
    number: int
    attempt: int
    spec: JsonFields
    drives: list[JsonFields]
    set_point_timing: JsonFields | None
    cause: str
    channels: Channels
