"""Friction that depends on the direction of motion, in its dry and its viscous part."""

from collections.abc import Mapping

import numpy as np

from service.diagnosis.effects.effect import Effect, Model, named
from service.diagnosis.effects.patch import Patch, dry
from service.diagnosis.rows.signals import Tracks


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    mean, half, viscous = (parameters[k] for k in ("coulomb", "coulomb_difference", "viscous_difference"))
    return dry(mean + half, mean - half, viscous=viscous, backward_viscous=-viscous)


def _possible(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> bool:
    """Whether friction is positive in each direction; otherwise the effect is an offset."""
    return parameters["coulomb"] >= 0 and abs(parameters["coulomb_difference"]) <= 1.05 * parameters["coulomb"]


EFFECT = Effect(
    name="asymmetric_friction",
    physics="tau = Fc sign(v) + Fd |sign(v)| + bd |v|; Fc + Fd forward, Fc - Fd backward",
    source="Janot, Gautier and Brunot, Data set and reference models of EMPS (2019), direction-dependent friction",
    sentence="The axis rubs more in one direction than in the other.",
    visible_in=("backward_slow", "backward_fast"),
    entry="motor_friction.backward_coulomb, backward_viscous",
    coefficients=named(("coulomb", "N m"), ("coulomb_difference", "N m"), ("viscous_difference", "N m s/rad")),
    contains=("coulomb_friction", "effort_offset"),
    columns=lambda tracks, model, shape: [tracks.direction, np.abs(tracks.direction), np.abs(tracks.velocity)],
    scenario=_scenario,
    essential=1,
    possible=_possible,
)
