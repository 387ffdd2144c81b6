"""The stored result of a sweep, in the file next to its recording. Complex numbers are pairs [re, im].

These are typed dictionaries, not models: the job of a campaign reads those of all earlier sweeps. Their hash shows
that they are unchanged, and validation of a million numbers would take longer than the identification.
"""

from typing import NotRequired, TypedDict, final

from pydantic import JsonValue

Pairs = list[list[float]]
Spec = dict[str, JsonValue]  # of `SweepSpec`


@final
class SpectrumDocument(TypedDict):
    """Bins of a sweep with lines, or of a record without."""

    spec: Spec
    samples: int
    frequency: list[float]
    line: list[bool]
    effort: Pairs
    velocity: Pairs
    names: list[str]
    regressors: list[Pairs]
    load_velocity: Pairs | None


@final
class NoiseDocument(TypedDict):
    """Excited lines of a noise run, period by period."""

    spec: Spec
    frequency: list[float]
    reference: list[Pairs]
    effort: list[Pairs]
    velocity: list[Pairs]


@final
class TrackDocument(TypedDict):
    """Harmonics of one axis of a trajectory."""

    spec: Spec
    harmonics: Pairs
    position: Pairs
    load_position: Pairs | None
    noise: float | None
    slope: NotRequired[float]  # not in files from before simultaneous sweeps


AnySpectrum = SpectrumDocument | NoiseDocument | TrackDocument


JsonFields = dict[str, JsonValue]  # the fields of a frozen class of another package


class NoiseGain(TypedDict):
    """Factor by which the white noise of a channel increased by its correction."""

    effort: float
    velocity: float


class ChannelCorrection(TypedDict, total=False):
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
    channels: ChannelCorrection
