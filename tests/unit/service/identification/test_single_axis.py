"""Sweeps of axes that moved at once never pass for sweeps of single axes."""

import numpy as np
import pytest

from service.errors import BadInput
from service.estimation import estimate_document
from service.identification import Spectrum, identify, spectrum
from service.recording import Recording, Sweep, SweepSpec
from service.robot import Robot


def free(robot: Robot, axis: str, **fields: object) -> Spectrum:
    """8 s to and fro, for which J = 250 kg m^2."""
    time = np.arange(4000) / 500
    turn, inertia = 2 * np.pi * np.array([0.4, 1.1]), 250.0
    speed = np.sin(np.outer(time, turn)) @ [0.3, 0.1]
    acceleration = np.cos(np.outer(time, turn)) @ ([0.3, 0.1] * turn)
    way = -np.cos(np.outer(time, turn)) @ ([0.3, 0.1] / turn)
    effort = inertia * acceleration + 90 * speed + np.random.default_rng(1).normal(0, 2.0, len(time))
    told = {"id": axis, "axis": axis, "pose": (0.0, 0.0), "offset_velocity": 0.0, "excitation": "trajectory"}
    spec = SweepSpec.model_validate({**told, "sample_rate": 500.0, **fields})
    return spectrum(robot, Sweep(spec, Recording(time, effort, speed, way)))


def test_records_of_two_axes_at_once_are_refused(robot: Robot) -> None:
    both = [free(robot, "lift", started_at=20.0), free(robot, "swing", started_at=20.0)]
    with pytest.raises(BadInput, match="sweep swing: swing moved while lift did in sweep lift"):
        identify(robot, both)
    with pytest.raises(BadInput, match="correct started_at"):
        estimate_document(robot, both)


def test_an_overlap_is_enough_and_one_after_the_other_is_none(robot: Robot) -> None:
    lift = free(robot, "lift", started_at=20.0)
    with pytest.raises(BadInput, match="started_at 27 and 20 s"):
        identify(robot, [lift, free(robot, "swing", started_at=27.0)])
    for told in ({"started_at": 28.0}, {"started_at": 20.0, "pose": (0.0, 0.5)}):
        assert len(identify(robot, [lift, free(robot, "swing", **told)]).axes) == 2


def test_a_block_that_says_how_many_axes_it_moved_is_believed(robot: Robot) -> None:
    """The other axis may be missing from the bundle."""
    with pytest.raises(BadInput, match="sweep swing: its block 'trajectory 3 of 2 axes' moved several axes at once"):
        identify(robot, [free(robot, "swing", block="trajectory 3 of 2 axes")])
    assert identify(robot, [free(robot, "swing", block="trajectory 3 of 1 axes")]).axes
