"""Friction that does not grow in proportion to the speed: a lubricant that thins by shear, or is churned."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, ShapeParameter, named, spread
from service.diagnosis.effects.patch import Inexpressible, Patch
from service.diagnosis.rows.signals import Tracks

Array = NDArray[np.float64]

STEP = 0.8  # of the torque at the slowest speed, at a tenth of it: so flat a law is a step
BEND = 0.05  # of the slowest speed: below, the law is a power of the speed


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    velocity, exponent = shape
    return [law(tracks.velocity, velocity, exponent)]


def law(speed: Array, velocity: float, exponent: float) -> Array:
    """Carreau's x (1 + x^2)^((n - 1)/2), x = v/v0: linear below v0, a power n of the speed above; 1 at v0 for n = 1."""
    ratio = speed / velocity
    return ratio * (1 + ratio**2) ** ((exponent - 1) / 2)


def _shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    slow, fast = tracks.speed, float(np.abs(tracks.velocity).max())
    return (
        ShapeParameter("velocity", "rad/s", spread(BEND * slow, fast, 5), 0.02 * BEND * slow, 2 * fast),
        ShapeParameter("exponent", "", (0.0, 0.4, 0.7, 1.5, 2.0), -0.5, 3.0),
    )


def _possible(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> bool:
    """Whether friction opposes the motion at all speeds that were run, and is no step, which dry friction is."""
    slow = tracks.speed
    near, at = law(np.array([slow / 10, slow]), parameters["velocity"], parameters["exponent"])
    if near > STEP * at:
        return False
    speed = np.linspace(0.0, float(np.abs(tracks.velocity).max()), 20)[1:]
    torque = parameters["coefficient"] * law(speed, parameters["velocity"], parameters["exponent"])
    return bool(np.all(torque + model.viscous * speed > 0))


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    """The simulator's law is a power of the speed."""
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
