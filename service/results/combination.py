"""Sweeps and trajectories in one problem: "combination" of an estimate."""

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
    """Of an effort harmonic, N m (N), model error included; `scatter` of the periods alone, null with single ones."""

    harmonic: float
    scatter: float | None


class FreeMotionAxis(Part):
    """What free motion leaves of an axis' effort, N m (N): in the fit, held out, and between equal motions."""

    residual_rms: float
    held_out_rms: float
    held_out_percent: float
    noise_floor_rms: float | None


class Combination(Part):
    """The joint estimate; `became_identifiable`: what neither sweeps nor trajectories alone identify."""

    base_parameters: tuple[CombinedParameter, ...]
    became_identifiable: tuple[str, ...] = ()
    trajectories: tuple[tuple[str, ...], ...] = ()
    noise: dict[str, EffortNoise] = Field(default={})
    free_motions: tuple[tuple[str, ...], ...] = ()
    free_motion_axes: dict[str, FreeMotionAxis] = Field(default={})
