"""What is comparable over campaigns, and what is said of the robots of a type."""

from datetime import UTC, datetime, timedelta

import pytest

from service.identification.fleet.survey import (
    AxisMeasured,
    CampaignMeasured,
    FleetRules,
    RobotMeasured,
    in_pose,
    newest_ratio,
    pose_key,
    series,
    survey,
)

START = datetime(2026, 1, 1, tzinfo=UTC)
RULES = FleetRules(probability=0.01, campaigns=12, remeasure_days=31)
A, B, C, D = (pose_key((0.0, position)) for position in (0.0, 0.5, 1.0, 1.5))


def campaign(number: int, values: dict[tuple[int, ...], float], calibration: float = 1.0) -> CampaignMeasured:
    poses = {pose: in_pose([value], [100.0], [0.1]) for pose, value in values.items()}
    return CampaignMeasured(
        number, START + timedelta(days=30 * number), {"joint_1": AxisMeasured(poses, calibration, 0.02)}
    )


def test_the_mean_of_a_pose_by_hand() -> None:
    found = in_pose([100.0, 110.0], [100.0, 100.0], [1.0, 1.1])
    assert found.log_value == pytest.approx(4.65283, abs=1e-5)  # (ln 100 + ln 110) / 2
    assert found.log_ratio == pytest.approx(0.0476551, abs=1e-6)
    assert found.std == pytest.approx(0.01 / 2**0.5)


def test_only_common_poses_are_compared_with_equal_weights() -> None:
    """The pose that one campaign lacks is left out of all; otherwise its J would look like a change."""
    one, two = campaign(1, {A: 100.0, B: 200.0, C: 400.0}), campaign(2, {A: 100.0, B: 200.0})
    history, left_out = series("r", "joint_1", [one, two])
    assert left_out == 0
    first, second = history.measurements
    assert first.value == pytest.approx(second.value)


def test_other_poses_or_another_gain_begin_a_new_series() -> None:
    other = campaign(1, {C: 100.0, D: 100.0})
    same = [campaign(number, {A: 100.0, B: 200.0}) for number in (2, 3)]
    history, left_out = series("r", "joint_1", [other, *same])
    assert ([one.campaign for one in history.measurements], left_out) == ([2, 3], 1)
    calibrated = campaign(4, {A: 100.0, B: 200.0}, calibration=1.05)
    history, left_out = series("r", "joint_1", [other, *same, calibrated])
    assert ([one.campaign for one in history.measurements], left_out) == ([4], 3)


def test_an_axis_that_was_never_measured_has_no_series() -> None:
    history, left_out = series("r", "joint_9", [campaign(1, {A: 100.0})])
    assert (history.measurements, left_out) == ((), 0)
    assert newest_ratio("r", "joint_9", [campaign(1, {A: 100.0})])[0].measurements == ()


def test_who_is_due_and_who_never_was_measured() -> None:
    new, old = (RobotMeasured(name, "cell", 1, (campaign(k, {A: 100.0}),)) for name, k in (("new", 2), ("old", 0)))
    never = RobotMeasured("never", None, 0, ())
    found = survey("type", [new, old, never], RULES, START + timedelta(days=61))
    assert {one.serial: one.due for one in found.robots} == {"new": False, "old": True, "never": True}
    assert found.robots[0].due_at == START + timedelta(days=91)
    assert found.robots[2].measured_at is None
    assert found.robots[0].axes["joint_1"].change is None  # one campaign is no history
    assert found.robots[0].axes["joint_1"].difference is None  # three robots are too few


def test_a_step_and_an_outlier_are_named_with_their_size() -> None:
    noise = (0.0, 0.05, -0.05, 0.02, -0.02, 0.04)
    robots = []
    for k in range(6):
        step, far = (1.0 if k == 1 else 0.0), (20.0 if k == 2 else 0.3 * k)
        values = [100.0 + far + noise[(n + k) % 6] + (step if n >= 3 else 0.0) for n in range(6)]
        robots.append(
            RobotMeasured(f"R{k}", "cell", 6, tuple(campaign(n, {A: value}) for n, value in enumerate(values, 1)))
        )
    found = survey("type", robots, RULES, START)
    assert [one.serial for one in found.robots if one.changed] == ["R1"]
    change = found.robots[1].axes["joint_1"].change
    assert change is not None
    assert change.since == 4
    assert change.change_percent == pytest.approx(1.0, abs=0.1)
    assert [one.serial for one in found.robots if one.outlier] == ["R2"]
    difference = found.robots[2].axes["joint_1"].difference
    assert difference is not None
    assert difference.difference_percent == pytest.approx(19.0, abs=1.0)
    assert not difference.by_gain  # 20 % is ten standard deviations of its gain


def test_without_campaigns_there_is_nothing_to_say() -> None:
    found = survey("type", [], RULES, START)
    assert (found.robots, found.axes) == ((), ())
