"""Friction that grows with a power of the speed other than one."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, ShapeParameter, named
from service.diagnosis.patch import Patch, positive
from service.diagnosis.signals import Tracks

Array = NDArray[np.float64]


UNIT = 0.01  # rad/s (m/s): the coefficient is the torque at this speed


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    return [np.sign(tracks.velocity) * (np.abs(tracks.velocity) / UNIT) ** shape[0]]


def _shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    return (ShapeParameter("exponent", "", (0.4, 0.55, 0.7, 1.4, 1.7, 2.0, 2.5), 0.3, 3.0),)


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    exponent = parameters["exponent"]
    power = {"coefficient": positive(parameters, "coefficient") / UNIT**exponent, "exponent": exponent}
    return {"train": {"motor_friction": {"power": power}}}


EFFECT = Effect(
    name="nonlinear_viscous_friction",
    physics="tau = c |v/v0|^a sign(v), v0 = 0.01 rad/s (m/s)",
    source="Harnoy, Friedland and Cohn, IEEE Control Systems 28 (2008); lubricant shear thinning, 0 < a < 1",
    sentence="Friction does not grow in proportion to the speed.",
    visible_in=("forward_fast", "backward_fast"),
    entry="motor_friction.power",
    coefficients=named(("coefficient", "N m")),
    columns=_columns,
    scenario=_scenario,
    shape=_shape,
)
