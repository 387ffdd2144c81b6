"""Joint estimate from sweeps and trajectories: "combination" of an estimate."""

from pydantic import Field

from service.results.part import Part


class CombinedParameter(Part):
    """A base parameter of the whole dynamics, SI; a std is null where its source does not determine it."""

    name: str
    value: float
    std: float | None
    std_total: float | None = None
    std_sweeps: float | None = None
    std_trajectories: float | None = None
    std_nominal: float | None = None
    source: str
    identified: bool
    reason: str


class EffortNoise(Part):
    """Noise of an effort harmonic, N m (N), including model error; `scatter` from periods, null with a single one.

    `warning` if it still changed in the last round of weighting.
    """

    harmonic: float
    scatter: float | None
    warning: str = ""


class FreeMotionAxis(Part):
    """Residual of an axis' effort in free motion, N m (N): in the fit, held out, and between equal motions.

    `warning` if the fit still changed in its last round.
    """

    residual_rms: float
    held_out_rms: float
    held_out_percent: float
    noise_floor_rms: float | None
    warning: str = ""


class Combination(Part):
    """The joint estimate; `became_identifiable`: parameters that neither sweeps nor trajectories identify alone."""

    base_parameters: tuple[CombinedParameter, ...]
    became_identifiable: tuple[str, ...] = ()
    trajectories: tuple[tuple[str, ...], ...] = ()
    noise: dict[str, EffortNoise] = Field(default={})
    free_motions: tuple[tuple[str, ...], ...] = ()
    free_motion_axes: dict[str, FreeMotionAxis] = Field(default={})
