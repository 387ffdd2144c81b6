"""Exciting trajectories: about their centre, within their limits, better for looking longer, refused without room."""

import numpy as np
import pytest

from service import BadInput
from service.identification.design.excitation import velocity_setpoint
from service.identification.design.exciting_trajectory import (
    Trajectory,
    TrajectoryLimits,
    TrajectoryShape,
    design_trajectory,
    nominal_effort,
    steady_motion,
)
from service.identification.model import dynamic_base
from service.model import Robot
from tests.random_chain import random_arm

pytestmark = pytest.mark.slow

SHAPE = TrajectoryShape(period=4.0, harmonics=3, periods=2, ramp=1.0, settle=0.5)


def robot() -> Robot:
    return random_arm(3, 3, motor_inertia=1e-3, rated_effort=500.0)


def limits(effort: float = 1e4) -> TrajectoryLimits:
    ones = np.ones(3)
    return TrajectoryLimits(-0.8 * ones, 1.0 * ones, 0.5 * ones, 1.5 * ones, effort * ones)


def design(steps: int = 10, lim: TrajectoryLimits | None = None, seed: int = 1) -> Trajectory:
    r = robot()
    return design_trajectory(
        r, dynamic_base(r).columns, lim or limits(), SHAPE, lambda path: True, seed=seed, restarts=5, steps=steps
    )


def test_it_swings_about_its_centre_during_the_window() -> None:
    trajectory = design()
    start = trajectory.excitations[0].measure_from
    time = np.linspace(start, start + SHAPE.period, 4000, endpoint=False)
    np.testing.assert_allclose(trajectory.path(time).mean(axis=0), trajectory.center, atol=1e-9)
    np.testing.assert_allclose(trajectory.path(np.zeros(1))[0], trajectory.start, atol=1e-12)
    motion = steady_motion(trajectory, time - start)
    np.testing.assert_allclose(motion.position, trajectory.path(time), atol=1e-9)
    np.testing.assert_allclose(motion.acceleration[1:-1], np.gradient(motion.velocity, time, axis=0)[1:-1], atol=1e-5)


def test_it_keeps_its_limits_from_standstill_to_standstill() -> None:
    r, lim = robot(), limits(effort=250.0)
    trajectory = design(lim=lim)
    time = np.linspace(0, trajectory.duration, 3000)
    path = trajectory.path(time)
    velocity = np.stack([velocity_setpoint(each, time) for each in trajectory.excitations], -1)
    assert (path > lim.lower - 1e-3).all()
    assert (path < lim.upper + 1e-3).all()
    assert (np.abs(velocity) < 1.01 * lim.velocity).all()
    assert (np.abs(np.gradient(velocity, time, axis=0)) < 1.02 * lim.acceleration).all()
    still = steady_motion(trajectory, np.linspace(0, SHAPE.period, 300))
    assert np.abs(nominal_effort(r, still)).max() < 250.0 * 1.01
    assert np.ptp(path, axis=0).min() > 0.05


def test_looking_longer_does_not_make_it_worse() -> None:
    assert design(steps=40).condition < design(steps=0).condition


def test_the_same_seed_gives_the_same() -> None:
    np.testing.assert_array_equal(design(seed=4).path(np.arange(8.0)), design(seed=4).path(np.arange(8.0)))


def test_without_room_there_is_none() -> None:
    r = robot()
    with pytest.raises(BadInput, match="none of 3 shapes"):
        design_trajectory(r, dynamic_base(r).columns, limits(), SHAPE, lambda path: False, restarts=3)
    with pytest.raises(BadInput, match="none of 5 shapes"):
        design(lim=limits(effort=1.0))
