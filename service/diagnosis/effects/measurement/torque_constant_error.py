"""Wrong torque constant in the drive: each torque value is too large, or too small, by the same factor."""

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Readout
from service.diagnosis.rows.rigid import load_rows, nominal_parameters
from service.diagnosis.rows.signals import Tracks

Array = NDArray[np.float64]


def _readout(tracks: Tracks, change: Array, covariance: Array) -> Readout:
    robot, index = tracks.robot, tracks.robot.index(tracks.joint)
    nominal = load_rows(robot, index, tracks.poses) @ nominal_parameters(robot)
    weight = np.repeat(tracks.sizes**2, len(tracks.poses)) * nominal
    weight /= weight @ nominal
    return {"gain_error": (float(weight @ change.ravel()), float(np.sqrt(max(weight @ covariance @ weight, 0.0))), "")}


EFFECT = Effect(
    name="torque_constant_error",
    physics="tau = e (J a + b v + gravity); CAD's prior alone tells e from other links",
    source="Gautier and Briot, J. Dyn. Sys. Meas. Control 136 (2014), Global identification of joint drive gains",
    sentence="The drive's torque constant is wrong: all torques are told too large or too small.",
    visible_in=("forward_slow", "backward_slow"),
    entry="effort_gain",
    readout=_readout,
    scenario=lambda parameters, tracks, model: {"train": {"effort_gain": parameters["gain_error"]}},
    by_test_mass=True,
    by_load=True,
    possible=lambda parameters, tracks, model: parameters["gain_error"] > -1,
)
