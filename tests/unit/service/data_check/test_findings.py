"""Each finding on an axis by formula: its name, its number, and that nothing else is said of the axis."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from service.data_check import DataFinding, check, findings_document, untrustworthy
from service.model import Robot, Sweep, build_robot
from service.model.results.diagnosis import CheckedAxis
from tests.unit.service.data_check.conftest import (
    INERTIA,
    OFFSET,
    POSE,
    RATED,
    lift_sweep,
)

Sweeps = tuple[Sweep, ...]
Change = Callable[[Sweeps], Sweeps]
ALL = ("0000", "0001", "0002", "0003")
RATIO = 170.0
PLACES = (-0.71, -0.37, 0.02, 0.33, 0.64)  # rad of lift


def column(name: str, change: Callable[[np.ndarray], np.ndarray], those: slice = slice(None)) -> Change:
    """One column of all or some of the sweeps becomes another."""

    def changed(sweeps: Sweeps) -> Sweeps:
        few = {sweep.spec.id for sweep in sweeps[those]}
        return tuple(
            replace(one, recording=replace(one.recording, **{name: change(getattr(one.recording, name))}))
            if one.spec.id in few
            else one
            for one in sweeps
        )

    return changed


def times(name: str, factor: float) -> Change:
    return column(name, lambda values: factor * values)


def turned(sweeps: Sweeps) -> Sweeps:
    """An encoder that counts the other way."""
    return times("velocity", -1.0)(times("position", -1.0)(sweeps))


def late(name: str, samples: int) -> Change:
    return column(name, lambda values: np.roll(values, samples))


def steps(count: int) -> Change:
    """So many over the rated torque."""
    return column("effort", lambda values: np.round(values * count / RATED) * RATED / count)


def told(**spec: object) -> Change:
    """The sweeps as bundle.json has them."""
    return lambda sweeps: tuple(replace(one, spec=one.spec.model_copy(update=spec)) for one in sweeps)


def shaken(sweeps: Sweeps) -> Sweeps:
    """By the floor, with another phase in each."""
    phases = iter((0.0, 1.9, 0.7, 3.0))
    wave = np.arange(len(sweeps[0].recording.time)) * 2 * np.pi * 7.5 / 1000
    return column("effort", lambda values: values + 0.01 * RATED * np.sin(wave + next(phases)))(sweeps)


def of_repeats(sweeps: Sweeps) -> Sweeps:
    """Repeats at another level."""
    return column("effort", lambda values: values + 0.03 * RATED, slice(1, None, 2))(sweeps)


def with_load_encoder(sweeps: Sweeps) -> Sweeps:
    return tuple(
        replace(one, recording=replace(one.recording, load_position=1.1 * one.recording.position)) for one in sweeps
    )


def holding(sweeps: Sweeps) -> Sweeps:
    noise = np.random.default_rng(3)
    return column("effort", lambda values: 700 + 5 * noise.standard_normal(len(values)))(sweeps)


def only(found: Sequence[DataFinding], code: str) -> DataFinding:
    assert [one.code for one in found] == [code], found
    assert found[0].axis in ("lift", None)
    return found[0]


def near(value: float, rel: float = 2e-3) -> object:
    return pytest.approx(value, rel=rel)


@pytest.mark.parametrize("change", [tuple, late("effort", 2), steps(1000)])
def test_nothing_is_said_of_a_sound_axis(robot: Robot, sweeps: Sweeps, change: Change) -> None:
    """Two milliseconds of effort are left to the diagnosis; per mille of the rated torque are usual steps."""
    assert check(robot, change(sweeps)) == ()


@pytest.mark.parametrize(
    ("change", "code", "value", "word"),
    [
        # gravity's stiffness is 2.3 % of the inertia
        (times("effort", 1000.0), "effort_unit", near(1000.0, 0.03), "N mm"),
        (times("effort", 100 / RATED), "effort_unit", near(100 / RATED, 0.03), "percent of rated effort"),
        (times("effort", 1 / 170), "effort_unit", near(1 / 170, 0.03), "the motor side"),
        (times("effort", 60.0), "effort_scale", near(60.0, 0.03), "no unit explains it"),
        (times("effort", -1.0), "effort_sign", near(-INERTIA, 0.03), "wrong sign"),
        (times("velocity", 180 / np.pi), "velocity_unit", near(180 / np.pi), "degrees/s"),
        (times("velocity", 5100 / np.pi), "velocity_unit", near(5100 / np.pi), "turns/min on the motor side"),
        (times("velocity", 1.03), "velocity_scale", near(1.03), "1.03 times the slope of position"),
        (times("velocity", 0.99), "velocity_scale", near(0.99), "limit 1 +- 0.005"),
        (times("velocity", -1.0), "velocity_sign", near(-1.0), "Reverse the sign of velocity"),
        (times("position", 180 / np.pi), "position_unit", near(180 / np.pi), "in degrees"),
        (times("position", -1.0), "position_sign", near(-1.0), "Reverse the sign of position"),
        (turned, "motion_sign", near(-1.0, 1e-2), "Reverse the sign of position and velocity"),
        (late("velocity", 4), "channel_delay", pytest.approx(4e-3, abs=2e-4), "late against position"),
        *((late("effort", n), "channel_delay", pytest.approx(1e-3 * n, abs=1e-3), "effort") for n in (-12, 8, 15)),
        (holding, "wrong_axis", None, "does not answer to the motion"),
        (steps(128), "coarse_steps", near(1 / 128, 1e-6), "effort"),
        (shaken, "not_repeatable", None, "at 7.5 Hz"),
        (of_repeats, "not_repeatable", None, "mean effort of repeats differs"),
        (with_load_encoder, "gear_ratio", near(1.1, 1e-3), "direct encoder"),
        (column("time", lambda t: t + 0.005 * (np.arange(len(t)) > 2500)), "clock", near(6.0), "time jumps"),
        (times("time", 1.01), "clock", near(1000 / 1.01), "Hz"),
    ],
)
def test_what_is_wrong_in_all_sweeps_is_told_alone_with_its_value(
    robot: Robot, sweeps: Sweeps, change: Change, code: str, value: object, word: str
) -> None:
    found = only(check(robot, change(sweeps)), code)
    assert value is None or found.value == value
    assert word in f"{found.sentence} {found.action}"
    assert found.sweeps == ALL
    assert (found.severity == "warning") == (code == "not_repeatable")
    assert (untrustworthy((found,), "lift") == ()) == (found.severity == "warning")


def test_torque_that_ends_at_a_limit(robot: Robot, sweeps: Sweeps) -> None:
    limit = float(np.quantile(np.concatenate([s.recording.effort for s in sweeps]), 0.95))
    found = only(check(robot, column("effort", lambda v: np.minimum(v, limit))(sweeps)), "clipped")
    assert f"ends at {limit:.6g}" in found.sentence


@pytest.mark.parametrize(
    ("name", "size"), [("effort", 0.05 * RATED), ("velocity", OFFSET), ("position", 0.001), ("effort", -RATED)]
)
def test_a_spike_in_one_sweep(robot: Robot, sweeps: Sweeps, name: str, size: float) -> None:
    spiky = column(name, lambda values: values + size * (np.arange(len(values)) == 2345), slice(1))
    found = only(check(robot, spiky(sweeps)), "spikes")
    assert found.sweeps == ("0000",)
    assert found.value == pytest.approx(abs(size), rel=0.2)


def test_counts_that_an_encoder_lost_are_no_lost_samples(robot: Robot, sweeps: Sweeps) -> None:
    jump = column("position", lambda values: values + 0.001 * (np.arange(len(values)) > 2500), slice(1))
    assert only(check(robot, jump(sweeps)), "lost_counts").sweeps == ("0000",)


def test_a_channel_that_holds_its_value(robot: Robot, sweeps: Sweeps) -> None:
    def held(values: np.ndarray) -> np.ndarray:
        return np.where((np.arange(len(values)) >= 2000) & (np.arange(len(values)) < 2060), values[2000], values)

    found = {one.code: one for one in check(robot, column("effort", held, slice(1))(sweeps))}
    assert found["frozen"].value == pytest.approx(0.06, abs=2e-3)


@pytest.mark.parametrize("name", ["effort", "velocity", "position"])
def test_a_dead_channel(robot: Robot, sweeps: Sweeps, name: str) -> None:
    found = check(robot, column(name, lambda v: np.full_like(v, v[0]))(sweeps))
    assert "frozen" in {one.code for one in found}
    assert untrustworthy(found, "lift") != ()


def test_lost_samples_are_counted_and_are_no_other_finding(robot: Robot, sweeps: Sweeps) -> None:
    def cut(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values[:2000], values[2040:], values[-40:] + 40 * (values[-1] - values[-2])])

    for name in ("effort", "velocity", "position"):
        sweeps = column(name, cut, slice(1))(sweeps)
    found = {one.code: one for one in check(robot, sweeps)}
    assert not {"velocity_scale", "not_repeatable", "lost_counts"} & found.keys()
    lost = found["time_jump"]
    assert lost.value is not None
    assert abs(lost.value) == pytest.approx(40, rel=0.05)


@pytest.mark.parametrize(
    ("pose", "words"),
    [(POSE, "where lift stands"), (POSE[::-1], "those of lift in all poses")],
)
def test_a_record_under_the_name_of_another_axis(
    robot: Robot, sweeps: Sweeps, pose: tuple[float, ...], words: str
) -> None:
    """Swing stands elsewhere; where its pose has changed places, too, inertia, weight and friction are lift's."""
    found = [one for one in check(robot, told(axis="swing", pose=pose)(sweeps)) if one.code == "wrong_axis"]
    assert [one.axis for one in found] == ["swing"]
    assert words in found[0].sentence


def test_a_pose_in_degrees(robot: Robot, sweeps: Sweeps) -> None:
    found = check(robot, told(pose=tuple(np.degrees(POSE).tolist()))(sweeps))
    assert {one.code for one in found} == {"wrong_pose", "outside_limits"}


def in_places(ripple: float, order: float) -> Sweeps:
    """Both directions in every place, with a ripple of the motor's angle, N m."""
    found: list[Sweep] = []
    for number, (place, offset) in enumerate((place, offset) for place in PLACES for offset in (OFFSET, -OFFSET)):
        sweep = lift_sweep(number, offset)
        position = sweep.recording.position + place - POSE[1]
        effort = sweep.recording.effort + ripple * np.sin(order * RATIO * position + 0.3)
        spec = sweep.spec.model_copy(update={"pose": (POSE[0], place)})
        found.append(Sweep(spec, replace(sweep.recording, position=position, effort=effort)))
    return tuple(found)


@pytest.mark.parametrize(
    ("known", "ripple", "order", "expected"),
    [
        ((), 0.02 * RATED, 24.0, {"ripple_order": (24.0, "warning")}),
        ((24.0,), 0.02 * RATED, 24.0, {}),
        ((), 0.0, 24.0, {}),
        ((24.0,), 0.02 * RATED, 24.0 * 1.002, {"gear_ratio": (near(1.002 * RATIO, 2e-4), "warning")}),
    ],
)
def test_a_ripple_of_a_known_order_and_of_others(
    robot: Robot, known: tuple[float, ...], ripple: float, order: float, expected: dict[str, tuple[object, str]]
) -> None:
    axes = (robot.axes[0], robot.axes[1].model_copy(update={"cogging_orders": known}))
    robot = replace(robot, description=robot.description.model_copy(update={"axes": axes}))
    found = check(robot, in_places(ripple, order))
    # CAD's weight is that of one pose here: the arm hangs alike in all
    assert {one.code: (one.value, one.severity) for one in found if one.code != "effort_scale"} == expected


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
    robot: Robot, sweeps: Sweeps, of_robot: dict[str, object], of_lift: dict[str, object], code: str
) -> None:
    axes = [robot.axes[0].model_dump(), robot.axes[1].model_dump() | of_lift]
    description = robot.description.model_validate(robot.description.model_dump() | {"axes": axes} | of_robot)
    found = only(check(build_robot(description, robot.urdf_text), sweeps), code)
    assert found.axis is None if of_robot else "lift" in found.sentence


def test_an_axis_is_judged_by_its_own_and_the_robots_findings(robot: Robot, sweeps: Sweeps) -> None:
    found = check(robot, times("effort", -1.0)(sweeps))
    assert untrustworthy(found, "lift") == found
    assert untrustworthy(found, "swing") == ()
    document = findings_document(robot, sweeps, found)
    assert document.axes == {"lift": CheckedAxis(sweeps=4, trustworthy=False, codes=("effort_sign",))}
    assert document.findings[0].sweeps == ALL


def test_one_sweep_that_is_too_short_to_judge(robot: Robot) -> None:
    sweeps = (lift_sweep(1),)
    for name in ("time", "effort", "velocity", "position"):
        sweeps = column(name, lambda values: values[:3])(sweeps)
    assert only(check(robot, sweeps), "clock").value == pytest.approx(5.0)
