"""Limits of the monitor against values of the normal table."""

import numpy as np
import pytest

from service.benefit.monitor import alarm_probability, smallest_effort


def test_one_false_alarm_in_a_shift() -> None:
    assert alarm_probability(1000.0, 8.0) == pytest.approx(1 / 28_800_000)


def test_noise_alone_is_a_two_sided_tail() -> None:
    three_sigma = 0.002699796  # of the normal table: outside of three standard deviations, both sides
    assert smallest_effort(np.zeros(1), np.array([2.0]), 0.0, three_sigma) == pytest.approx(6.0, rel=1e-6)


def test_a_pose_that_is_off_counts_from_its_mean_on_one_side() -> None:
    one_sided = 0.001349898  # beyond three standard deviations, one side; the other one is 23 away
    assert smallest_effort(np.array([20.0]), np.array([2.0]), 0.0, one_sided) == pytest.approx(26.0, rel=1e-6)


def test_of_two_poses_that_are_off_alike_each_has_its_share() -> None:
    limit = smallest_effort(np.array([20.0, 0.0]), np.array([2.0, 2.0]), 0.0, 0.001349898 / 2)
    assert limit == pytest.approx(26.0, rel=1e-6)  # the pose that is right adds nothing there


def test_never_below_what_was_recorded_without_a_collision() -> None:
    assert smallest_effort(np.zeros(1), np.array([2.0]), 9.5, 0.002699796) == 9.5


def test_a_model_that_leaves_nothing_but_a_constant() -> None:
    assert smallest_effort(np.array([3.0, -5.0]), np.zeros(2), 0.0, 1e-8) == pytest.approx(5.0)
