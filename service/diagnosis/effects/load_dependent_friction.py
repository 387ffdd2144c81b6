"""Dry friction that grows with the torque that the gear transmits."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, named
from service.diagnosis.patch import Patch, dry, positive
from service.diagnosis.signals import Tracks

Array = NDArray[np.float64]


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    transmitted = tracks.gravity + model.load_inertia * tracks.acceleration
    return [tracks.direction, tracks.direction * np.abs(transmitted)]


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    return dry(parameters["coulomb"], load_dependence=positive(parameters, "load_dependence"))


EFFECT = Effect(
    name="load_dependent_friction",
    physics="tau = (Fc + eta |Ts|) sign(v), Ts the torque through the gear",
    source="Hamon, Gautier and Garrec, IROS 2010, Dynamic identification of robots with a dry friction model",
    sentence="Friction grows with the torque that the gear transmits.",
    visible_in=("backward_slow", "forward_slow"),
    entry="motor_friction.load_dependence",
    coefficients=named(("coulomb", "N m"), ("load_dependence", "")),
    contains=("coulomb_friction",),
    columns=_columns,
    of_model=True,
    scenario=_scenario,
    essential=1,
)
