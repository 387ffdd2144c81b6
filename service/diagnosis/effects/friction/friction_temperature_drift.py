"""Friction that decreases while the gear is heated by dissipation."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, ShapeParameter, named, spread
from service.diagnosis.effects.patch import Inexpressible, Patch, dry, positive
from service.diagnosis.rows.signals import Tracks

Array = NDArray[np.float64]


def warmth(tracks: Tracks, time_constant: float, exponent: float = 1.0) -> Array:
    """Temperature (n, t) of a gear that is heated by a power of its speed and cools with a time constant. Unit: rad (m)
    for exponent 1 (heat of dry friction: the distance); rad^2/s for exponent 2 (heat of viscous friction).
    """
    heat = np.zeros_like(tracks.velocity)
    step = 1 / tracks.rate
    keep = float(np.exp(-step / time_constant))
    level, clock = 0.0, 0.0
    ages = np.power(keep, np.arange(1.0, heat.shape[1] + 1))
    for row in sorted(range(len(tracks.specs)), key=lambda k: tracks.specs[k].started_at):
        spec, count = tracks.specs[row], int(tracks.inside[row].sum())
        level *= np.exp(-max(spec.started_at - clock, 0.0) / time_constant)
        # T_n = keep T_{n-1} + |v_n| step, in closed form to avoid a loop over samples
        gains = np.abs(tracks.velocity[row, :count]) ** exponent * step
        gained = np.multiply(np.cumsum(np.divide(gains, ages[:count])), ages[:count])
        heat[row, :count] = level * ages[:count] + gained
        heat[row, count:] = heat[row, count - 1]
        level, clock = float(heat[row, count - 1]), spec.started_at + count * step
    return heat


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    warm = warmth(tracks, *shape)
    return [tracks.direction, tracks.direction * warm, tracks.velocity * warm]


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    """In the scenario, dissipated power heats the gear, not distance: with capacity = power / speed, it is 1 K/rad.

    Friction decreases as exp(-loss T); the column is the tangent of that.
    """
    coulomb, change = positive(parameters, "coulomb"), parameters["coulomb_change"]
    if change >= 0:
        raise Inexpressible(f"coulomb_change = {change:.3g} is not below 0: friction that grows with warmth")
    speed = np.abs(tracks.velocity)
    typical = float(np.sum(speed**2) / np.sum(speed))
    warming = {
        "heat_capacity": coulomb + model.viscous * typical,
        "time_constant": parameters["time_constant"],
        "coulomb_loss": -change / coulomb,
        "viscous_loss": -parameters["viscous_change"] / model.viscous if model.viscous > 0 else 0.0,
    }
    return {"train": dry(coulomb)["train"] | {"warming": warming}}


def _shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    return (
        ShapeParameter("time_constant", "s", spread(20.0, 5000.0, 6), 10.0, 1e4),
        ShapeParameter("heating_exponent", "", (1.0, 2.0), 1.0, 2.0),
    )


def _possible(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> bool:
    """Whether dry friction is positive (against the motion), cold and warm."""
    warm = float(warmth(tracks, parameters["time_constant"], parameters["heating_exponent"]).max())
    # 0.003 of the rated effort: dry friction this little below 0 counts as zero
    least = -0.003 * tracks.robot.axis(tracks.joint).rated_effort
    return min(parameters["coulomb"], parameters["coulomb"] + parameters["coulomb_change"] * warm) > least


def _lasts(tracks: Tracks) -> bool:
    return float(np.ptp([spec.started_at for spec in tracks.specs])) > 20.0


EFFECT = Effect(
    name="friction_temperature_drift",
    physics="tau = (Fc + fc T) sign(v) + fv T v, T' = |v| - T/tau",
    source="Simoni et al., IEEE/ASME Trans. Mechatronics 20 (2015), friction of robot joints with temperature",
    sentence="Friction changes as the axis warms up.",
    visible_in=("revisit_forward_slow", "revisit_backward_slow"),
    entry="warming",
    coefficients=named(("coulomb", "N m"), ("coulomb_change", "N m/rad"), ("viscous_change", "N m s/rad2")),
    contains=("coulomb_friction",),
    columns=_columns,
    scenario=_scenario,
    essential=1,
    possible=_possible,
    shape=_shape,
    applies=_lasts,
)
