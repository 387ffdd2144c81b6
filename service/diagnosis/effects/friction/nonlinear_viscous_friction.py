"""Viscous friction that is not proportional to the speed (shear-thinning or churned lubricant)."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, ShapeParameter, named, spread
from service.diagnosis.effects.patch import Inexpressible, Patch
from service.diagnosis.rows.signals import Tracks

Array = NDArray[np.float64]


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    velocity, exponent = shape
    return [law(tracks.velocity, velocity, exponent)]


def law(speed: Array, velocity: float, exponent: float) -> Array:
    """Carreau's law x (1 + x^2)^((n - 1)/2), x = v/v0: linear below v0, power n of the speed above; n = 1: linear."""
    ratio = speed / velocity
    return ratio * (1 + ratio**2) ** ((exponent - 1) / 2)


def _shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    bend = 0.05  # of the slowest speed: below, the law is a pure power of the speed
    slow, fast = tracks.speed, float(np.abs(tracks.velocity).max())
    return (
        ShapeParameter("velocity", "rad/s", spread(bend * slow, fast, 5), 0.02 * bend * slow, 2 * fast),
        ShapeParameter("exponent", "", (0.0, 0.4, 0.7, 1.5, 2.0), -0.5, 3.0),
    )


def _possible(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> bool:
    """Whether friction is positive at all measured speeds, and the law is not a step (that would be dry friction)."""
    slow = tracks.speed
    near, at = law(np.array([slow / 10, slow]), parameters["velocity"], parameters["exponent"])
    # 0.8 torque at a tenth of the slowest speed over that at the slowest speed: above, the law is a step
    if near > 0.8 * at:
        return False
    speed = np.linspace(0.0, float(np.abs(tracks.velocity).max()), 20)[1:]
    torque = parameters["coefficient"] * law(speed, parameters["velocity"], parameters["exponent"])
    return bool(np.all(torque + model.viscous * speed > 0))


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    """In the scenario the law is a power of the speed."""
    if parameters["velocity"] > tracks.speed or parameters["coefficient"] <= 0:
        raise Inexpressible("friction that thins by shear is no power of the speed")
    exponent = parameters["exponent"]
    power = {"coefficient": parameters["coefficient"] / parameters["velocity"] ** exponent, "exponent": exponent}
    return {"train": {"motor_friction": {"power": power}}}


EFFECT = Effect(
    name="nonlinear_viscous_friction",
    physics="tau = c x (1 + x^2)^((n - 1)/2), x = v/v0",
    source="Carreau, Trans. Soc. Rheology 16 (1972); Waiboer, Aarts and Jonker, IDETC 2005, lubricated robot joints",
    sentence="Friction does not grow in proportion to the speed.",
    visible_in=("forward_fast", "backward_fast"),
    entry="motor_friction.power",
    coefficients=named(("coefficient", "N m")),
    columns=_columns,
    scenario=_scenario,
    shape=_shape,
    possible=_possible,
)
