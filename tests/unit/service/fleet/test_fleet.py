"""The control chart and the comparison of siblings: by hand, at their false-alarm rate, and on planted changes."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from service import BadInput
from service.identification.fleet.statistics import (
    FEWEST,
    AlarmRate,
    CampaignValue,
    History,
    between_campaigns,
    looks,
    outliers,
)

pytestmark = pytest.mark.slow

OWN, BETWEEN = 0.0015, 0.001  # relative: of an estimate of J, and between campaigns; set before the runs
MONTHS, ROBOTS, AXES = 12, 8, 3
RATE = AlarmRate(probability=0.01, robots=ROBOTS, quantities=AXES, campaigns=MONTHS)
FOUND = 0.01  # the planted change


def history(robot: str, values: list[float] | np.ndarray, std: float = OWN, calibration: float = 1.0) -> History:
    return History(robot, tuple(CampaignValue(n, float(v), std, calibration) for n, v in enumerate(values, 1)))


def plant(random: np.random.Generator) -> np.ndarray:
    """Values (axes, robots, months): robots differ by far more than a month does."""
    shape = (AXES, ROBOTS, MONTHS)
    own = random.normal(0, OWN, shape) + random.normal(0, BETWEEN, shape)
    return own + random.normal(0, 0.02, (AXES, ROBOTS, 1))


def alarms(values: np.ndarray, rate: AlarmRate) -> set[int]:
    """The robots with an alarm in any month, each month judged when it comes with what is known by then."""
    found: set[int] = set()
    for month in range(FEWEST, values.shape[2] + 1):
        for axis in values:
            told = looks([history(str(n), each[:month]) for n, each in enumerate(axis)], rate)
            found |= {int(robot) for robot, look in told.items() if look is not None and look.alarm}
    return found


def test_by_hand() -> None:
    values = [1.0, 2.0, 3.0, 5.0]
    one = history("a", values, std=0.5)
    between = between_campaigns([one])
    tau = sum((b - a) ** 2 - 0.5 for a, b in pairwise(values)) / 2 / 3
    assert between.variance == pytest.approx(tau)
    assert between.freedom == pytest.approx(2 * 9 / 8)
    look = looks([one], AlarmRate(0.04, 1, 1, 4))["a"]
    assert look is not None
    variance = 0.25 + tau
    # means of 1, 2 and of 3, 5, variance 1/2 + 1/2; the drift: slope 1.3 a campaign over 3, variance 9 / 5
    assert 2.5 / np.sqrt(variance) < 3.9 / np.sqrt(variance * 9 / 5)
    assert (look.campaign, look.since, look.change) == (4, None, pytest.approx(3.9))
    assert look.std == pytest.approx(np.sqrt(variance * 9 / 5))
    assert look.limit == pytest.approx(stats.t.isf(0.04 / 16 / 2, 2 * 9 / 8))
    step = looks([history("a", [1.0, 1.0, 1.0, 3.0, 3.0])], RATE)["a"]
    assert step is not None
    assert (step.since, step.change) == (4, pytest.approx(2.0))


@pytest.mark.slow
def test_the_false_alarm_rate_is_kept() -> None:
    """400 plants at 5 %: as many plants with an alarm as chance gives once in 1,000 times, at most."""
    random = np.random.default_rng(8160)
    rate = AlarmRate(0.05, ROBOTS, AXES, MONTHS)
    wrong = sum(bool(alarms(plant(random), rate)) for _ in range(400))
    assert wrong <= stats.binom.isf(0.001, 400, 0.05), wrong


@pytest.mark.parametrize("seed", range(20))
def test_a_change_of_1_percent_is_found_and_the_other_seven_are_quiet(seed: int) -> None:
    """A step after the fifth month, on one axis."""
    random = np.random.default_rng(200 + seed)
    values = plant(random)
    robot, axis = random.integers(ROBOTS), random.integers(AXES)
    values[axis, robot, 5:] += FOUND
    assert alarms(values, RATE) == {int(robot)}


@pytest.mark.slow
def test_a_slow_drift_to_1_percent_is_mostly_found_within_the_year() -> None:
    """Even from month to month, 1 % from the third to the twelfth: in 85 of 100 plants."""
    found = wrong = 0
    for seed in range(1000, 1100):
        random = np.random.default_rng(seed)
        values = plant(random)
        robot, axis = random.integers(ROBOTS), random.integers(AXES)
        values[axis, robot, 2:] += np.linspace(0, FOUND, MONTHS - 2)
        told = alarms(values, RATE)
        found += int(robot) in told
        wrong += bool(told - {int(robot)})
    assert found >= 85, found
    assert wrong <= stats.binom.isf(0.001, 100, RATE.probability), wrong


def test_without_history_nothing_is_judged() -> None:
    assert looks([history("a", [0.0] * (FEWEST - 1))], RATE) == {"a": None}
    assert between_campaigns([history("a", [1.0])]).freedom == 0
    assert RATE.limit(0.0) == np.inf


def test_a_new_torque_gain_begins_a_new_series() -> None:
    before, after = history("a", [0.0] * 5).measurements, history("a", [0.05] * 2, calibration=1.05).measurements
    assert History("a", (*before, *after)).comparable == after
    assert looks([History("a", (*before, *after))], RATE) == {"a": None}


@pytest.mark.parametrize(("value", "std"), [(float("nan"), 1.0), (1.0, 0.0), (1.0, float("inf"))])
def test_what_is_no_number_is_refused(value: float, std: float) -> None:
    with pytest.raises(BadInput, match=r"robot a campaign 7: value .* must be finite and std above 0"):
        looks([History("a", (CampaignValue(7, value, std),))], RATE)


def test_bad_rates_are_refused() -> None:
    with pytest.raises(BadInput, match=r"probability: is 0\.9"):
        AlarmRate(0.9, 1, 1, 12).limit(5)
    with pytest.raises(BadInput, match="must be 1 or more"):
        AlarmRate(0.1, 0, 1, 12).limit(5)
    with pytest.raises(BadInput, match="probability: is 0"):
        outliers([], 0.0, 1)


def test_an_outlier_by_hand() -> None:
    siblings = [history(str(n), [value]) for n, value in enumerate((1.0, 2.0, 3.0, 9.0))]
    last = outliers(siblings, 0.05, 1, {"3": 4.0})[-1]
    spread = 1.0 * np.sqrt(1 + 1 / 3)
    assert last.difference == pytest.approx(7.0)
    assert last.probability == pytest.approx(2 * stats.t.sf(7 / spread, 2))
    assert not last.outlier  # 4 robots tell little
    assert last.by_gain  # 7 is less than two standard deviations of the gain
    assert outliers(siblings[:3], 0.05, 1) == ()


def test_outliers_keep_their_rate_and_find_what_is_planted() -> None:
    random = np.random.default_rng(8161)
    wrong = 0
    for _ in range(1000):
        same = [history(str(n), [value]) for n, value in enumerate(random.normal(0, 0.02, ROBOTS))]
        wrong += any(one.outlier for one in outliers(same, 0.05, 1))
    assert wrong <= stats.binom.isf(0.001, 1000, 0.05), wrong
    values = [*random.normal(0, 0.02, ROBOTS - 1), 0.3]
    told = outliers([history(str(n), [value]) for n, value in enumerate(values)], 0.05, AXES)
    assert [one.robot for one in told if one.outlier] == [str(ROBOTS - 1)]
