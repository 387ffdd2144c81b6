"""The stored result of a sweep, in the file next to its recording. Complex numbers are pairs [re, im].

These are typed dictionaries, not models: the job of a campaign reads those of all earlier sweeps. Their hash shows
that they are unchanged, and validation of a million numbers would take longer than the identification.
"""

from typing import TypedDict, final

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


AnySpectrum = SpectrumDocument | NoiseDocument | TrackDocument
