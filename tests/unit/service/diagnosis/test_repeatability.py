"""What does not repeat: a line that is otherwise each time is found with its frequency, coloured noise is none."""

from functools import cache

import numpy as np
import pytest

from service.diagnosis.fit.equations import Equations
from service.diagnosis.localisation.repeatability import Unrepeated, unrepeated
from tests.numeric.campaign import max100
from tests.unit.service.diagnosis.following import SLOW, equations_of, swept

POSES = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.9, 0.9, 0, 0, 0]])


@cache
def quiet() -> Equations:
    robot = max100()
    return equations_of(robot, "joint_2", swept("joint_2", POSES, blocks=SLOW))


def seen(left: np.ndarray) -> Unrepeated:
    found = unrepeated(quiet(), left)
    assert found is not None
    return found


def noise(colour: float) -> np.ndarray:
    """Rows of the sensor's RMS times `colour`, correlated over a few rows."""
    white = np.random.default_rng(2).standard_normal((quiet().right.shape[0], quiet().right.shape[1] + 3))
    smooth = np.sum([white[:, k : k + quiet().right.shape[1]] for k in range(4)], axis=0) / 2.0
    return colour * quiet().sensor_noise * smooth


def test_a_vibration_that_comes_with_any_phase_is_told_with_its_frequency() -> None:
    given = quiet()
    time = np.arange(given.right.shape[1]) * 2 / given.tracks.rate
    phases = np.random.default_rng(3).uniform(0, 2 * np.pi, len(given.right))[:, None]
    amplitude = 10 * given.sensor_noise
    found = seen(amplitude * np.sin(2 * np.pi * 7.3 * time + phases) + noise(1.0))
    assert found.is_physical
    assert found.frequency == pytest.approx(7.3, abs=0.05)
    assert found.rms == pytest.approx(amplitude / np.sqrt(2), rel=0.3)
    assert "7.3 Hz" in found.sentence("joint_2", "N m")


def test_coloured_sensor_noise_is_no_machine() -> None:
    found = seen(noise(2.0))
    assert found.rms == pytest.approx(2 * found.sensor_rms, rel=0.1)
    assert not found.is_physical
    assert found.frequency is None


def test_what_repeats_is_not_its_matter() -> None:
    left = np.broadcast_to(1e3 * np.sin(np.arange(quiet().right.shape[1]) / 9.0), quiet().right.shape)
    found = unrepeated(quiet(), np.array(left))
    assert found is None or found.rms < 1e-6
