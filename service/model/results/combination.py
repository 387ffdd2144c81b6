"""Joint estimate from sweeps and trajectories: "combination" of an estimate."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from service.model.results.part import Column, Part, Shown, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LARGEST = 1e15  # of a value in SI, as in a URDF: above any robot; its square does not overflow
Bounded = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]


class StandardParameters(Part):
    """One physical robot with these base parameters: ten numbers per link, and the motors' inertias, by name."""

    links: dict[str, dict[str, Bounded]]
    motor_inertias: dict[str, Bounded]


class Physical(Part):
    """Change of the base parameters to be physically consistent, standard deviations; `warning` if the search for the
    nearest robot did not converge."""

    deviation_in_std: float | None
    warning: str = ""


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


class FrictionPoint(Part):
    """Friction at a velocity, rad/s (m/s): Coulomb, viscous and beyond, N m (N)."""

    velocity: float
    effort: float
    std: float


class FreeMotionAxis(Part):
    """Residual of an axis' effort in free motion, N m (N): in the fit, held out, and between equal motions.

    `simple_held_out_rms`: of the simple estimator on the same parts. `friction`: where more than Coulomb and viscous
    friction predicts held-out parts better. `lacks`: what the residual shows that the model
    lacks; it has widened the standard deviations. `warning` if the fit still changed in its last round.
    """

    residual_rms: float
    held_out_rms: float
    held_out_percent: float
    noise_floor_rms: float | None
    simple_held_out_rms: float | None = None
    friction: tuple[FrictionPoint, ...] = ()
    lacks: tuple[str, ...] = ()
    warning: str = ""


class FreeMotionFit(Part):
    """How free motions are fitted, chosen by held-out parts.

    `simple_estimator`: the one beside it; `prior_widened`: factor of the nominal model's standard deviations.
    """

    simple_estimator: str
    prior_widened: float


class Combination(Shown, Part):
    """The joint estimate; `became_identifiable`: parameters that neither sweeps nor trajectories identify alone.

    `covariance` of the base parameters, in their order. `warnings`: what is not physical.
    """

    base_parameters: tuple[CombinedParameter, ...]
    became_identifiable: tuple[str, ...] = ()
    trajectories: tuple[tuple[str, ...], ...] = ()
    noise: dict[str, EffortNoise] = Field(default={})
    free_motions: tuple[tuple[str, ...], ...] = ()
    free_motion_axes: dict[str, FreeMotionAxis] = Field(default={})
    free_motion_fit: FreeMotionFit | None = None
    covariance: tuple[tuple[float, ...], ...] = ()
    standard_parameters: StandardParameters | None = None
    physical: Physical | None = None
    warnings: tuple[str, ...] = ()

    def table(self) -> Table:
        """Every base parameter of the whole dynamics, what determines it, or why nothing does."""
        runs, motions = len(self.trajectories), len(self.free_motions)
        all_of = self.base_parameters
        became = set(self.became_identifiable)
        std = tuple(one.std for one in all_of)
        by = tuple(one.reason or one.source + (", only now" if one.name in became else "") for one in all_of)
        return Table(
            f"Sweeps, {runs} trajectories and {motions} free motions together, SI",
            (
                Column("parameter", tuple(one.name for one in all_of)),
                Column("value", tuple(one.value for one in all_of), std=std),
                Column("std", std, std=std),
                Column("std by sweeps", tuple(one.std_sweeps for one in all_of), ".2g"),
                Column("by trajectories", tuple(one.std_trajectories for one in all_of), ".2g"),
                Column("of the model", tuple(one.std_nominal for one in all_of), ".2g"),
                Column("determined by", by),
            ),
        )

    def plot(self) -> "Axes":
        """Draws how well each source determines each base parameter."""
        from service.model.results import plots  # matplotlib

        return plots.sources(self.table())

    def shown(self) -> Sequence[Table | str]:
        """Also how well efforts of free motions are predicted along parts that the fit has not seen."""
        identified = sum(one.identified for one in self.base_parameters)
        parts: list[Table | str] = [
            self.table(),
            f"{identified} of {len(self.base_parameters)} base parameters identified",
        ]
        if axes := self.free_motion_axes:
            columns = (
                Column("axis", tuple(axes)),
                Column("left by the fit", tuple(axis.residual_rms for axis in axes.values()), ".3g"),
                Column("held out", tuple(axis.held_out_rms for axis in axes.values()), ".3g"),
                Column("simple estimator", tuple(axis.simple_held_out_rms for axis in axes.values()), ".3g"),
                Column("% of rated", tuple(axis.held_out_percent for axis in axes.values()), ".3g"),
                Column("noise floor", tuple(axis.noise_floor_rms for axis in axes.values()), ".3g"),
                Column("the model lacks", tuple(", ".join(axis.lacks) for axis in axes.values())),
            )
            parts.append(Table("Free motions, effort below the band's end, RMS, SI", columns))
            if self.free_motion_fit is not None:
                parts.append(f"The simple estimator is {self.free_motion_fit.simple_estimator}.")
        return parts + [f"Warning: {warning}" for warning in self.warnings]
