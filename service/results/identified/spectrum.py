"""What is kept of a sweep, as it stands in the file beside its recording. Complex numbers are pairs [re, im].

Typed dictionaries and no models: a campaign's job reads those of all sweeps before it, which are as they were written
(their hash says so), and checking a million numbers again would take longer than identifying with them.
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
    load_velocity: NotRequired[Pairs | None]  # the first versions wrote none


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


AnySpectrum = SpectrumDocument | NoiseDocument | TrackDocument
