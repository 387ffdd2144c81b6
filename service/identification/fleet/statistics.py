r"""The control chart: has a robot changed?

With each campaign, the newest `AlarmRate.campaigns` of the robot are tested together. Contrasts c (sum c_i = 0) of
its values x test for a change: a step before each campaign except the first (mean after minus mean before), and a drift
(slope over the number of the campaign, times the number of campaigns minus one). Each is divided by its standard
deviation,

    t = sum_i c_i x_i / sqrt( sum_i c_i^2 (s_i^2 + tau^2) ),

s are the estimates' own, without the common torque gain; tau^2 is the variance between campaigns of all robots of the
type (`between_campaigns`). The limit is Student's, two-sided, with the degrees of freedom of tau^2, at the false-alarm
probability divided by robots, quantities, looks in the time and contrasts per look (Bonferroni): for any dependence
between the tests, the probability of a false alarm in that time is not larger.

Outliers: is the difference of a robot from the others of its type larger than their scatter?

Each robot's mean is compared with the mean of the others, in units of the others' scatter (leave-one-out): Student's t
with n - 2 degrees of freedom for n robots of one type. The scatter of the others includes the differences of their
torque gains and of their construction, so no assumption on the gains is needed; `by_gain`: whether the uncertainty
of this robot's gain alone could explain the difference.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
from scipy.special import stdtr, stdtrit

from service import BadInput
from service.model import Array


@dataclass(frozen=True, slots=True)
class CampaignValue:
    """A quantity from one campaign.

    `value` and `std` in one unit; for an inertia its logarithm and its relative standard deviation. `std` is
    conditional on the torque gain: all campaigns with one calibration have the same gain, so it cancels in their
    differences. `calibration`: the value of the gain that the estimate used.
    """

    campaign: int
    value: float
    std: float
    calibration: float = 1.0


@dataclass(frozen=True)
class History:
    """The campaigns of one robot, the oldest first."""

    robot: str
    measurements: tuple[CampaignValue, ...]

    @property
    def comparable(self) -> tuple[CampaignValue, ...]:
        """The campaigns with the calibration of the newest one: another torque gain starts a new series."""
        newest = self.measurements[-1].calibration if self.measurements else 1.0
        alike = list(takewhile(lambda one: one.calibration == newest, reversed(self.measurements)))
        return tuple(alike[::-1])

    def arrays(self) -> tuple[Array, Array]:
        """Values (n,) and variances (n,) of comparable campaigns. BadInput if one is not finite or std not above 0."""
        found = self.comparable
        for one in found:
            if not (np.isfinite(one.value) and np.isfinite(one.std) and one.std > 0):
                place = f"robot {self.robot} campaign {one.campaign}"
                raise BadInput(place, f"value {one.value:g}, std {one.std:g}: both must be finite and std above 0")
        return np.array([one.value for one in found]), np.square([one.std for one in found])


@dataclass(frozen=True, slots=True)
class Between:
    """Variation of a quantity between campaigns in addition to its own uncertainty.

    `variance` in the squared unit of the quantity, `freedom` its degrees of freedom; 0 if it is unknown.
    """

    variance: float
    freedom: float


def between_campaigns(histories: Sequence[History]) -> Between:
    r"""The variance between campaigns of robots of one type, from mean square successive differences.

    E (x_k - x_{k-1})^2 = 2 tau^2 + s_k^2 + s_{k-1}^2, so a slow drift hardly increases it and a step only once (von
    Neumann, Kent, Bellinson, Hart 1941). n campaigns of a robot give 2 (n - 1)^2 / (3 n - 4) degrees of freedom.
    """
    excess, count, freedom = 0.0, 0, 0.0
    for history in histories:
        values, variances = history.arrays()
        n = len(values)
        if n < 2:
            continue
        excess += float(np.sum(np.diff(values) ** 2 - variances[1:] - variances[:-1])) / 2
        count += n - 1
        freedom += 2 * (n - 1) ** 2 / (3 * n - 4)
    return Between(max(0.0, excess / count) if count else 0.0, freedom)


FEWEST = 3  # campaigns that are needed


@dataclass(frozen=True, slots=True)
class AlarmRate:
    """`probability` of any false alarm among `robots` and `quantities` of each in a time of `campaigns` a robot."""

    probability: float
    robots: int
    quantities: int
    campaigns: int

    def limit(self, freedom: float) -> float:
        """Limit of a standardised change; inf without degrees of freedom.

        BadInput for a probability outside of 0 to 0.5, a count below 1 or fewer campaigns than `FEWEST`.
        """
        if not 0 < self.probability <= 0.5:
            raise BadInput("probability", f"is {self.probability:g}, limit above 0 to 0.5")
        if min(self.robots, self.quantities) < 1 or self.campaigns < FEWEST:
            raise BadInput("alarm rate", f"robots and quantities must be 1 or more, campaigns {FEWEST} or more")
        # at most `campaigns` looks in the time, each with at most as many contrasts
        each = self.probability / (self.robots * self.quantities * self.campaigns**2)
        return float(-stdtrit(freedom, each / 2)) if freedom > 0 else np.inf


@dataclass(frozen=True, slots=True)
class Look:
    """The most significant change of a robot up to `campaign`, in the unit of the quantity.

    `since`: the first campaign after a step; None for a drift. `statistic`: change over std.
    """

    campaign: int
    since: int | None
    change: float
    std: float
    limit: float

    @property
    def statistic(self) -> float:
        return self.change / self.std

    @property
    def alarm(self) -> bool:
        return abs(self.statistic) > self.limit


def looks(histories: Sequence[History], rate: AlarmRate) -> dict[str, Look | None]:
    """Result for one quantity of robots of one type, by robot; None for fewer than `FEWEST` campaigns. BadInput."""
    between = between_campaigns(histories)
    limit = rate.limit(between.freedom)
    return {history.robot: _look(history, between, limit, rate.campaigns) for history in histories}


def _look(history: History, between: Between, limit: float, window: int) -> Look | None:
    values, variances = (each[-window:] for each in history.arrays())
    if len(values) < FEWEST:
        return None
    campaigns = [one.campaign for one in history.comparable][-window:]
    total = variances + between.variance
    found = [
        Look(
            campaigns[-1],
            None if step is None else campaigns[step],
            float(c @ values),
            float(np.sqrt(c**2 @ total)),
            limit,
        )
        for step, c in _contrasts(len(values))
    ]
    return max(found, key=lambda look: abs(look.statistic))


def _contrasts(count: int) -> Iterator[tuple[int | None, Array]]:
    """`count` contrasts, (count,) each: steps by the index of their first campaign, and the drift (None)."""
    for step in range(1, count):
        yield step, np.concatenate([np.full(step, -1 / step), np.full(count - step, 1 / (count - step))])
    centred = np.arange(count, dtype=np.float64) - (count - 1) / 2
    yield None, np.asarray((count - 1) * centred / float(centred @ centred), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Sibling:
    """A robot among those of its type: `difference` from the mean of the others, and its probability by chance."""

    robot: str
    difference: float
    probability: float
    outlier: bool
    by_gain: bool


def outliers(
    histories: Sequence[History], probability: float, quantities: int, gain_std: Mapping[str, float] | None = None
) -> tuple[Sibling, ...]:
    """All measured robots; () for fewer than 4.

    `probability` of any false outlier among all robots and `quantities`. `gain_std`: of the torque gain by robot, in
    the unit of the quantity. BadInput for a probability outside of 0 to 0.5.
    """
    if not 0 < probability <= 0.5:
        raise BadInput("probability", f"is {probability:g}, limit above 0 to 0.5")
    measured = [history for history in histories if history.measurements]
    if len(measured) < 4:  # the scatter would come from two others
        return ()
    means = np.array([history.arrays()[0].mean() for history in measured])
    freedom = len(means) - 2
    limit = float(-stdtrit(freedom, probability / (2 * len(means) * quantities)))
    found: list[Sibling] = []
    for number, history in enumerate(measured):
        others = np.delete(means, number)
        difference = float(means[number] - others.mean())
        spread = float(others.std(ddof=1) * np.sqrt(1 + 1 / len(others)))
        t = difference / spread if spread > 0 else (0.0 if difference == 0 else np.inf)
        # two standard deviations of the gain
        by_gain = abs(difference) <= 2.0 * (gain_std or {}).get(history.robot, 0.0)
        chance = 2 * float(stdtr(freedom, -abs(t)))
        found.append(Sibling(history.robot, difference, chance, abs(t) > limit, by_gain))
    return tuple(found)
