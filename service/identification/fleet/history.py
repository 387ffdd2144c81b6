"""The data compared over campaigns: one quantity of one robot, by campaign."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.model.errors import BadInput

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Measurement:
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
    measurements: tuple[Measurement, ...]

    @property
    def comparable(self) -> tuple[Measurement, ...]:
        """The campaigns with the calibration of the newest one: another torque gain starts a new series."""
        newest = self.measurements[-1].calibration if self.measurements else 1.0
        count = 0
        for measurement in reversed(self.measurements):
            if measurement.calibration != newest:
                break
            count += 1
        return self.measurements[len(self.measurements) - count :]

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
