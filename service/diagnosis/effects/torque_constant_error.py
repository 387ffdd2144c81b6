"""A torque constant that is not that of the data sheet: every torque is told too large, or too small."""

import numpy as np

from service.diagnosis.effects.effect import Effect, named
from service.diagnosis.signals import Tracks


def _pulls(tracks: Tracks) -> bool:
    return float(np.abs(tracks.gravity).max()) > 1e-6 * tracks.robot.axis(tracks.joint).rated_effort


EFFECT = Effect(
    name="torque_constant_error",
    physics="tau = e (J a + b v + gravity); inertia and friction are free, so gravity alone shows it",
    source="Gautier and Briot, J. Dyn. Sys. Meas. Control 136 (2014), Global identification of joint drive gains",
    sentence="The drive's torque constant is wrong: all torques are told too large or too small.",
    visible_in=("forward_slow", "backward_slow"),
    entry="effort_gain",
    coefficients=named(("gain_error", "")),
    columns=lambda tracks, model, shape: [tracks.gravity],
    scenario=lambda parameters, tracks, model: {"train": {"effort_gain": parameters["gain_error"]}},
    by_test_mass=True,
    applies=_pulls,
)
