"""Laws of friction are the same where they are named and where they are taken out."""

import numpy as np
import pytest

from service.diagnosis.effects.friction import law
from service.identification.axis.known_torque import LAWS, Motion

SPEED = np.linspace(-0.1, 0.1, 41)
LOAD = np.linspace(-400.0, 900.0, 41)
MOTION = Motion(SPEED, np.zeros(41), np.zeros(41), LOAD)


def test_a_lubricant_that_thins() -> None:
    told = {"coefficient": -30.0, "velocity": 0.03, "exponent": 0.4}
    expected = -30.0 * law(SPEED, 0.03, 0.4)
    assert LAWS["nonlinear_viscous_friction"](told, MOTION) == pytest.approx(expected)


def test_friction_that_grows_with_the_load_beyond_a_knee() -> None:
    told = {"coulomb": 20.0, "load_dependence": 0.05, "load_curvature": 0.01, "knee": 300.0}
    grown = 0.05 * (np.sqrt(LOAD**2 + 300.0**2) - 300.0) + 0.01 * LOAD**2 / 300.0
    assert LAWS["load_dependent_friction"](told, MOTION) == pytest.approx((20.0 + grown) * np.sign(SPEED))


def test_models_of_before_are_read_as_they_were_written() -> None:
    power = LAWS["nonlinear_viscous_friction"]({"coefficient": 5.0, "exponent": 0.5}, MOTION)
    assert power == pytest.approx(5.0 * np.sign(SPEED) * np.sqrt(np.abs(SPEED) / 0.01))
    straight = LAWS["load_dependent_friction"]({"coulomb": 20.0, "load_dependence": 0.05}, MOTION)
    assert straight == pytest.approx((20.0 + 0.05 * np.abs(LOAD)) * np.sign(SPEED))
