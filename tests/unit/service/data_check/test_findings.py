"""Each finding on an axis by formula: its name, its number, and that nothing else is said of the axis."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from service.data_check import DataFinding, check, findings_document, untrustworthy
from service.model.recording import Sweep
from service.model.robot import Robot, build_robot
from tests.unit.service.data_check.conftest import (
    INERTIA,
    OFFSET,
    POSE,
    RATED,
    lift_sweep,
)

Change = Callable[[np.ndarray], np.ndarray]


def column(sweeps: Sequence[Sweep], name: str, change: Change) -> tuple[Sweep, ...]:
    """The sweeps with one column changed."""
    return tuple(
        Sweep(sweep.spec, replace(sweep.recording, **{name: change(getattr(sweep.recording, name))}))
        for sweep in sweeps
    )


def only(found: Sequence[DataFinding], code: str) -> DataFinding:
    assert [one.code for one in found] == [code], found
    assert found[0].axis in ("lift", None)
    return found[0]


def test_nothing_is_said_of_a_sound_axis(robot: Robot, sweeps: tuple[Sweep, ...]) -> None:
    assert check(robot, sweeps) == ()


@pytest.mark.parametrize(
    ("name", "factor", "code", "value", "word"),
    [
        ("effort", 1000.0, "effort_unit", 1000.0, "N mm"),
        ("effort", 100 / RATED, "effort_unit", 100 / RATED, "percent of rated effort"),
        ("effort", 1 / 170, "effort_unit", 1 / 170, "the motor side"),
        ("effort", 60.0, "effort_scale", 60.0, "no unit explains it"),
        ("effort", -1.0, "effort_sign", -INERTIA, "wrong sign"),
        ("velocity", 180 / np.pi, "velocity_unit", 180 / np.pi, "degrees/s"),
        ("velocity", 170 * 30 / np.pi, "velocity_unit", 170 * 30 / np.pi, "turns/min on the motor side"),
        ("velocity", 1.03, "velocity_scale", 1.03, "1.03 times the slope of position"),
        ("velocity", 0.99, "velocity_scale", 0.99, "limit 1 +- 0.005"),
        ("velocity", -1.0, "velocity_sign", -1.0, "Reverse the sign of velocity"),
        ("position", 180 / np.pi, "position_unit", 180 / np.pi, "in degrees"),
        ("position", -1.0, "position_sign", -1.0, "Reverse the sign of position"),
    ],
)
def test_a_factor_is_told_with_its_value(
    robot: Robot, sweeps: tuple[Sweep, ...], name: str, factor: float, code: str, value: float, word: str
) -> None:
    found = only(check(robot, column(sweeps, name, lambda values: factor * values)), code)
    assert found.value == pytest.approx(value, rel=0.03 if name == "effort" else 2e-3)  # gravity's stiffness is 2.3 %
    assert word in f"{found.sentence} {found.action}"
    assert found.sweeps == ("0000", "0001", "0002", "0003")
    assert found.severity == "wrong"


def test_an_encoder_that_counts_the_other_way(robot: Robot, sweeps: tuple[Sweep, ...]) -> None:
    turned = column(column(sweeps, "velocity", lambda v: -v), "position", lambda v: -v)
    assert only(check(robot, turned), "motion_sign").value == pytest.approx(-1, rel=1e-2)


@pytest.mark.parametrize(
    ("name", "samples", "apart", "word"),
    [
        ("velocity", 4, 2e-4, "late against position"),
        *(("effort", samples, 1e-3, "") for samples in (-12, 8, 15)),
    ],
)
def test_a_late_channel_is_told_with_its_delay(
    robot: Robot, sweeps: tuple[Sweep, ...], name: str, samples: int, apart: float, word: str
) -> None:
    found = only(check(robot, column(sweeps, name, lambda v: np.roll(v, samples))), "channel_delay")
    assert found.value == pytest.approx(1e-3 * samples, abs=apart)
    assert word in found.sentence


def test_two_milliseconds_of_effort_are_left_to_the_diagnosis(robot: Robot, sweeps: tuple[Sweep, ...]) -> None:
    assert check(robot, column(sweeps, "effort", lambda v: np.roll(v, 2))) == ()


def test_torque_that_ends_at_a_limit(robot: Robot, sweeps: tuple[Sweep, ...]) -> None:
    limit = float(np.quantile(np.concatenate([s.recording.effort for s in sweeps]), 0.95))
    found = only(check(robot, column(sweeps, "effort", lambda v: np.minimum(v, limit))), "clipped")
    assert f"ends at {limit:.6g}" in found.sentence


@pytest.mark.parametrize(("steps", "told"), [(1000, ()), (128, ("coarse_steps",))])
def test_steps_of_torque(robot: Robot, sweeps: tuple[Sweep, ...], steps: int, told: tuple[str, ...]) -> None:
    """Per mille of the rated torque are usual; 8 bits over both directions are not."""
    step = RATED / steps
    found = check(robot, column(sweeps, "effort", lambda v: np.round(v / step) * step))
    assert tuple(one.code for one in found) == told
    assert all(one.value == pytest.approx(1 / steps, rel=1e-6) for one in found)


@pytest.mark.parametrize(
    ("name", "size"), [("effort", 0.05 * RATED), ("velocity", OFFSET), ("position", 0.001), ("effort", -RATED)]
)
def test_a_spike_in_one_sweep(robot: Robot, sweeps: tuple[Sweep, ...], name: str, size: float) -> None:
    def spiky(values: np.ndarray) -> np.ndarray:
        return values + size * (np.arange(len(values)) == 2345)

    found = only(check(robot, (*column(sweeps[:1], name, spiky), *sweeps[1:])), "spikes")
    assert found.sweeps == ("0000",)
    assert found.value == pytest.approx(abs(size), rel=0.2)


def test_a_channel_that_holds_its_value(robot: Robot, sweeps: tuple[Sweep, ...]) -> None:
    def held(values: np.ndarray) -> np.ndarray:
        return np.where((np.arange(len(values)) >= 2000) & (np.arange(len(values)) < 2060), values[2000], values)

    found = check(robot, (*column(sweeps[:1], "effort", held), *sweeps[1:]))
    assert "frozen" in {one.code for one in found}
    assert next(one for one in found if one.code == "frozen").value == pytest.approx(0.06, abs=2e-3)


@pytest.mark.parametrize("name", ["effort", "velocity", "position"])
def test_a_dead_channel(robot: Robot, sweeps: tuple[Sweep, ...], name: str) -> None:
    found = check(robot, column(sweeps, name, lambda v: np.full_like(v, v[0])))
    assert "frozen" in {one.code for one in found}
    assert untrustworthy(found, "lift") != ()


def test_lost_samples_are_counted_and_are_no_other_finding(robot: Robot, sweeps: tuple[Sweep, ...]) -> None:
    def cut(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values[:2000], values[2040:], values[-40:] + 40 * (values[-1] - values[-2])])

    short = sweeps[:1]
    for name in ("effort", "velocity", "position"):
        short = column(short, name, cut)
    found = {one.code: one for one in check(robot, (*short, *sweeps[1:]))}
    assert not {"velocity_scale", "not_repeatable", "lost_counts"} & found.keys()
    lost = found["time_jump"]
    assert lost.value is not None
    assert abs(lost.value) == pytest.approx(40, rel=0.05)


def test_a_gap_and_a_wrong_rate_of_the_clock(robot: Robot, sweeps: tuple[Sweep, ...]) -> None:
    gap = column(sweeps, "time", lambda t: t + 0.005 * (np.arange(len(t)) > 2500))
    assert only(check(robot, gap), "clock").value == pytest.approx(6.0)
    slow = column(sweeps, "time", lambda t: 1.01 * t)
    assert only(check(robot, slow), "clock").value == pytest.approx(1000 / 1.01)


def test_a_recording_of_another_axis(robot: Robot, sweeps: tuple[Sweep, ...]) -> None:
    """Told for swing, which stands elsewhere."""
    told = tuple(Sweep(sweep.spec.model_copy(update={"axis": "swing"}), sweep.recording) for sweep in sweeps)
    found = [one for one in check(robot, told) if one.code == "wrong_axis"]
    assert found
    assert found[0].axis == "swing"
    assert "where lift stands" in found[0].sentence


def test_effort_of_an_axis_that_holds(robot: Robot, sweeps: tuple[Sweep, ...]) -> None:
    noise = np.random.default_rng(3)
    found = only(
        check(robot, column(sweeps, "effort", lambda v: 700 + 5 * noise.standard_normal(len(v)))), "wrong_axis"
    )
    assert "does not answer to the motion" in found.sentence


def test_a_pose_in_degrees(robot: Robot, sweeps: tuple[Sweep, ...]) -> None:
    pose = tuple(float(np.degrees(angle)) for angle in POSE)
    told = tuple(Sweep(sweep.spec.model_copy(update={"pose": pose}), sweep.recording) for sweep in sweeps)
    assert {one.code for one in check(robot, told)} == {"wrong_pose", "outside_limits"}


def test_a_shaking_floor_is_a_warning_with_its_frequency(robot: Robot, sweeps: tuple[Sweep, ...]) -> None:
    phases = iter((0.0, 1.9, 0.7, 3.0))

    def shaken(values: np.ndarray) -> np.ndarray:
        return values + 0.01 * RATED * np.sin(2 * np.pi * 7.5 * np.arange(len(values)) / 1000 + next(phases))

    found = only(check(robot, column(sweeps, "effort", shaken)), "not_repeatable")
    assert "at 7.5 Hz" in found.sentence
    assert found.severity == "warning"
    assert untrustworthy((found,), "lift") == ()


@pytest.mark.parametrize(
    ("of_robot", "of_lift", "code"),
    [
        ({"gravity": (0.0, 0.0, -9810.0)}, {}, "gravity"),
        ({"prior": {"inertia": 30.0}}, {}, "prior"),
        ({}, {"rated_effort": RATED / 170}, "rated_effort"),
        ({}, {"motor_inertia": 20.0}, "motor_inertia"),
        ({}, {"motor_inertia": None}, "missing_nominal"),
    ],
)
def test_a_robot_file_that_cannot_be_or_that_the_records_contradict(
    robot: Robot, sweeps: tuple[Sweep, ...], of_robot: dict[str, object], of_lift: dict[str, object], code: str
) -> None:
    axes = [robot.axes[0].model_dump(), robot.axes[1].model_dump() | of_lift]
    description = robot.description.model_validate(robot.description.model_dump() | {"axes": axes} | of_robot)
    found = only(check(build_robot(description, robot.urdf_text), sweeps), code)
    assert found.axis is None if of_robot else "lift" in found.sentence


def test_a_direct_encoder_that_knows_another_gear(robot: Robot, sweeps: tuple[Sweep, ...]) -> None:
    with_load = tuple(
        Sweep(sweep.spec, replace(sweep.recording, load_position=1.1 * sweep.recording.position)) for sweep in sweeps
    )
    assert only(check(robot, with_load), "gear_ratio").value == pytest.approx(1.1, rel=1e-3)


def test_an_axis_is_judged_by_its_own_and_the_robots_findings(robot: Robot, sweeps: tuple[Sweep, ...]) -> None:
    found = check(robot, column(sweeps, "effort", lambda v: -v))
    assert untrustworthy(found, "lift") == found
    assert untrustworthy(found, "swing") == ()
    document = findings_document(robot, sweeps, found)
    assert document["axes"] == {"lift": {"sweeps": 4, "trustworthy": False, "codes": ["effort_sign"]}}
    assert document["findings"][0]["sweeps"] == ["0000", "0001", "0002", "0003"]


def test_one_sweep_that_is_too_short_to_judge(robot: Robot) -> None:
    sweep = lift_sweep(1)
    few = replace(
        sweep.recording, **{n: getattr(sweep.recording, n)[:3] for n in ("time", "effort", "velocity", "position")}
    )
    assert only(check(robot, (Sweep(sweep.spec, few),)), "clock").value == pytest.approx(5.0)
