"""Dry friction that increases with the torque transmitted by the gear."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, ShapeParameter, named
from service.diagnosis.effects.patch import Patch, dry, positive
from service.diagnosis.rows.signals import Tracks

Array = NDArray[np.float64]


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    torque, knee = model.transmitted(tracks.acceleration), shape[0]
    grows = np.hypot(torque, knee) - knee
    return [tracks.direction, tracks.direction * grows, tracks.direction * torque**2 / knee]


def _shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    torque = float(np.abs(model.gravity).max()) or tracks.robot.axis(tracks.joint).rated_effort
    return (ShapeParameter("knee", "N m", (0.02 * torque, 0.3 * torque, torque), 1e-3 * torque, 5 * torque),)


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    return dry(parameters["coulomb"], load_dependence=positive(parameters, "load_dependence"))


EFFECT = Effect(
    name="load_dependent_friction",
    physics="tau = (Fc + eta (sqrt(Ts^2 + T1^2) - T1) + e Ts^2 / T1) sign(v), Ts the torque through the gear, "
    "T1 the knee",
    source="Hamon, Gautier and Garrec, IROS 2010, Dynamic identification of robots with a dry friction model",
    sentence="Friction grows with the torque that the gear transmits.",
    visible_in=("backward_slow", "forward_slow"),
    entry="motor_friction.load_dependence",
    coefficients=named(("coulomb", "N m"), ("load_dependence", ""), ("load_curvature", "")),
    contains=("coulomb_friction",),
    columns=_columns,
    of_model=True,
    scenario=_scenario,
    essential=1,
    shape=_shape,
    possible=lambda parameters, tracks, model: parameters["load_dependence"] + parameters["load_curvature"] > 0,
)
