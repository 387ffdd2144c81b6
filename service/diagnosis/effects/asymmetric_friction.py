"""Friction that differs with the direction: dry and viscous part each."""

import numpy as np

from service.diagnosis.effects.effect import Effect, named

EFFECT = Effect(
    name="asymmetric_friction",
    physics="tau = Fc sign(v) + Fd |sign(v)| + bd |v|; Fc + Fd forward, Fc - Fd backward",
    source="Janot, Gautier and Brunot, Data set and reference models of EMPS (2019), direction-dependent friction",
    sentence="The axis rubs more in one direction than in the other.",
    visible_in=("backward_slow", "backward_fast", "standstill"),
    entry="motor_friction.backward_coulomb, backward_viscous",
    coefficients=named(("coulomb", "N m"), ("coulomb_difference", "N m"), ("viscous_difference", "N m s/rad")),
    columns=lambda tracks, model, shape: [tracks.direction, np.abs(tracks.direction), np.abs(tracks.velocity)],
    essential=1,
)
