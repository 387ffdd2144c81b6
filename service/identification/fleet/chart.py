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
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from service.identification.fleet.history import Between, History, between_campaigns
from service.model.errors import BadInput

Array = NDArray[np.float64]

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
