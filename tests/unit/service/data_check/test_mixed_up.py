"""What only all poses together tell: ripples of the motor, effort of another axis, repeats of another level."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from service.data_check import check
from service.model.recording import Sweep
from service.model.robot import Robot
from tests.unit.service.data_check.conftest import OFFSET, POSE, RATED, lift_sweep

RATIO = 170.0
PLACES = (-0.71, -0.37, 0.02, 0.33, 0.64)  # rad of lift

Change = Callable[[Sweep], np.ndarray]


def in_places(ripple: float, order: float) -> tuple[Sweep, ...]:
    """Both directions in every place, with a ripple of the motor's angle, N m."""
    found: list[Sweep] = []
    for number, (place, offset) in enumerate((place, offset) for place in PLACES for offset in (OFFSET, -OFFSET)):
        sweep = lift_sweep(number, offset)
        position = sweep.recording.position + place - POSE[1]
        effort = sweep.recording.effort + ripple * np.sin(order * RATIO * position + 0.3)
        spec = sweep.spec.model_copy(update={"pose": (POSE[0], place)})
        found.append(Sweep(spec, replace(sweep.recording, position=position, effort=effort)))
    return tuple(found)


def knowing(robot: Robot, *orders: float) -> Robot:
    axes = (robot.axes[0], robot.axes[1].model_copy(update={"cogging_orders": orders}))
    return replace(robot, description=robot.description.model_copy(update={"axes": axes}))


def changed(sweeps: tuple[Sweep, ...], effort: Change) -> tuple[Sweep, ...]:
    return tuple(Sweep(sweep.spec, replace(sweep.recording, effort=effort(sweep))) for sweep in sweeps)


def codes(robot: Robot, sweeps: tuple[Sweep, ...]) -> list[str]:
    # CAD's weight is that of one pose here: the arm hangs alike in all
    return [one.code for one in check(robot, sweeps) if one.code != "effort_scale"]


def test_an_order_that_the_robot_file_does_not_know(robot: Robot) -> None:
    told = [one for one in check(robot, in_places(0.02 * RATED, 24.0)) if one.code == "ripple_order"]
    assert [one.value for one in told] == [24.0]
    assert told[0].severity == "warning"


def test_a_known_order_is_no_finding_and_neither_is_noise(robot: Robot) -> None:
    assert codes(knowing(robot, 24.0), in_places(0.02 * RATED, 24.0)) == []
    assert codes(robot, in_places(0.0, 24.0)) == []


def test_a_gear_ratio_that_is_off_by_two_in_a_thousand(robot: Robot) -> None:
    told = check(knowing(robot, 24.0), in_places(0.02 * RATED, 24.0 * 1.002))
    assert [one.code for one in told] == ["gear_ratio"]
    assert told[0].value == pytest.approx(1.002 * RATIO, rel=2e-4)


def test_a_whole_record_under_the_name_of_another_axis(robot: Robot, sweeps: tuple[Sweep, ...]) -> None:
    """Its pose has changed places, too: it starts where it should, but inertia, weight and friction are lift's."""
    told = tuple(
        Sweep(sweep.spec.model_copy(update={"axis": "swing", "pose": POSE[::-1]}), sweep.recording) for sweep in sweeps
    )
    found = [one for one in check(robot, told) if one.code == "wrong_axis"]
    assert len(found) == 1
    assert "those of lift in all poses" in found[0].sentence


def test_counts_that_an_encoder_lost_are_no_lost_samples(robot: Robot, sweeps: tuple[Sweep, ...]) -> None:
    record = sweeps[0].recording
    jumped = record.position + 0.001 * (np.arange(len(record.time)) > 2500)
    found = check(robot, (Sweep(sweeps[0].spec, replace(record, position=jumped)), *sweeps[1:]))
    assert [one.code for one in found] == ["lost_counts"]


def test_repeats_of_another_level(robot: Robot, sweeps: tuple[Sweep, ...]) -> None:
    told = check(robot, changed(sweeps, lambda sweep: sweep.recording.effort + 0.03 * RATED * sweep.spec.repeat))
    assert [one.code for one in told] == ["not_repeatable"]
    assert "mean effort of repeats differs" in told[0].sentence
    assert told[0].severity == "warning"
