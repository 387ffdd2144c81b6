"""What a recording's manifest tells beside its file: where it comes from, and what was done to its channels."""

from typing import TypedDict

from pydantic import JsonValue

Told = dict[str, JsonValue]  # as another room's frozen class has it


class NoiseGain(TypedDict):
    """By how much the white noise of a channel grew when it was put right."""

    effort: float
    velocity: float


class Channels(TypedDict, total=False):
    """`timing` (`ChannelTiming`, s) and `noise_gain` where the channels were `corrected`."""

    corrected: bool
    timing: Told
    noise_gain: NoiseGain


class Facts(TypedDict, total=False):
    """Of a run that this process knows: its numbers, sweep, drives (`AxisIdentity`) and set-points (`SetPointTiming`).

    Of a stream that was left by another process: `campaign` and `sweep`. Of an imported bundle: `robot` and sweep.
    `cause`: why a recording is partial.
    """

    robot: str
    campaign: int
    sweep: int
    campaign_id: int
    number: int
    attempt: int
    spec: Told
    drives: list[Told]
    set_point_timing: Told | None
    cause: str
    channels: Channels
