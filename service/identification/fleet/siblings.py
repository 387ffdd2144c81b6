"""Outliers: is the difference of a robot from the others of its type larger than their scatter?

Each robot's mean is compared with the mean of the others, in units of the others' scatter (leave-one-out): Student's t
with n - 2 degrees of freedom for n robots of one type. The scatter of the others includes the differences of their
torque gains and of their construction, so no assumption on the gains is needed; `by_gain`: whether the uncertainty
of this robot's gain alone could explain the difference.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr, stdtrit

from service.identification.fleet.history import History
from service.model.errors import BadInput

FEWEST = 4  # robots: with fewer, the scatter would come from two others
_TWO = 2.0  # standard deviations of the gain


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
    """All measured robots; () for fewer than `FEWEST`.

    `probability` of any false outlier among all robots and `quantities`. `gain_std`: of the torque gain by robot, in
    the unit of the quantity. BadInput for a probability outside of 0 to 0.5.
    """
    if not 0 < probability <= 0.5:
        raise BadInput("probability", f"is {probability:g}, limit above 0 to 0.5")
    measured = [history for history in histories if history.measurements]
    if len(measured) < FEWEST:
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
        by_gain = abs(difference) <= _TWO * (gain_std or {}).get(history.robot, 0.0)
        chance = 2 * float(stdtr(freedom, -abs(t)))
        found.append(Sibling(history.robot, difference, chance, abs(t) > limit, by_gain))
    return tuple(found)
