"""Ripples that the robot file does not know, found in what a model leaves."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from service.diagnosis.fit.equations import Equations
from service.diagnosis.localisation.ripple_search import ripples, with_ripples
from service.diagnosis.rows.signals import row_samples
from service.model import Robot
from tests.numeric.campaign import max100
from tests.unit.service.diagnosis.following import SLOW, equations_of, swept

pytestmark = pytest.mark.slow

JOINT = "joint_2"
POSES = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.1, -0.5, 0, 0, 0], [0.0, 0.9, 0.9, 0, 0, 0]])


def knowing(robot: Robot, cogging: tuple[float, ...], transmission: tuple[float, ...] = ()) -> Robot:
    axes = tuple(
        axis.model_copy(update={"cogging_orders": cogging, "transmission_orders": transmission}) for axis in robot.axes
    )
    return replace(robot, description=robot.description.model_copy(update={"axes": axes}))


@cache
def measured(cogging: tuple[float, ...]) -> Equations:
    robot = knowing(max100(), cogging)
    return equations_of(robot, JOINT, swept(JOINT, POSES, robot=robot, blocks=SLOW))


def left_by(given: Equations, order: float, amplitude: float) -> np.ndarray:
    """A ripple of the motor's angle and noise of a tenth (n, rows)."""
    tracks = given.tracks
    angle = tracks.robot.axis(JOINT).gear_ratio * tracks.position[:, row_samples(tracks.effort.shape[1], tracks.rate)]
    noise = np.random.default_rng(5).standard_normal(angle.shape)
    return amplitude * (np.sin(order * angle + 0.4) + 0.1 * noise)


def test_an_order_that_the_file_does_not_know_is_found() -> None:
    given = measured((24.0,))
    found = ripples(given, left_by(given, 17.0, 5.0))
    assert found[0].order == pytest.approx(17.0, abs=0.02)
    assert found[0].rms == pytest.approx(5.0 / np.sqrt(2), rel=0.1)
    other, said = with_ripples(given.tracks.robot, JOINT, found)
    assert other.axis(JOINT).cogging_orders == (24.0, 17.0)
    assert other.axis(JOINT).gear_ratio == given.tracks.robot.axis(JOINT).gear_ratio
    assert said[0].code == "ripple_order"
    assert "ripples 17 times a motor turn" in said[0].sentence


def test_a_wrong_gear_ratio_is_told_with_the_right_one() -> None:
    """A known order that repeats 0.2 % too often everywhere."""
    given = measured((24.0,))
    ratio = given.tracks.robot.axis(JOINT).gear_ratio
    other, said = with_ripples(given.tracks.robot, JOINT, ripples(given, left_by(given, 24.0 * 1.002, 5.0)))
    assert other.axis(JOINT).gear_ratio == pytest.approx(1.002 * ratio, rel=2e-4)
    assert other.axis(JOINT).cogging_orders == (24.0,)
    assert said[0].code == "gear_ratio"
    assert said[0].value == pytest.approx(1.002 * ratio, rel=2e-4)


def test_noise_is_no_ripple_and_a_known_one_changes_nothing() -> None:
    given = measured((24.0,))
    assert ripples(given, np.random.default_rng(6).standard_normal(given.right.shape)) == ()
    robot = given.tracks.robot
    assert with_ripples(robot, JOINT, ripples(given, left_by(given, 24.0, 5.0))) == (robot, ())
