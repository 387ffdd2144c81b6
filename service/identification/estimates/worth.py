"""What a rigid model is worth where it is used: inertia and gravity torque of each axis over the workspace.

The sweeps determine combinations b of the parameters x, with covariance C; the others are CAD's x0. With P the prior's
covariance, in which mass, centre and inertia of a link are correlated as in the nearest physical robot
(`physical_consistency`), and K the combinations, a torque t = h x has given the sweeps

    mean t0 + h P K' (K P K' + C)^-1 (b - K x0),    variance  h P h' - h P K' (K P K' + C)^-1 K P h'.

The expected error of any model, of the exported one as of CAD, is the root of this variance and of the square of the
model's distance from this mean. A physical model with exactly the combinations b may be farther from it than CAD.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.model.physical_consistency import nominal_factor
from service.identification.model.regressor import axis_rows, gravity_rows
from service.model.robot import Robot

Array = NDArray[np.float64]

POSES = 100
TOLERANCE = 1.05  # of CAD's expected error, below which a difference has no consequence


@dataclass(frozen=True)
class Worth:
    """One quantity of an axis, RMS over the workspace, N m or kg m^2 (N or kg): the model's, its difference from CAD,
    and the expected errors of both after the sweeps.
    """

    value: float
    change: float
    error: float
    error_of_cad: float


@dataclass(frozen=True)
class AxisWorth:
    """An axis, with what the model is worth for it."""

    joint: str
    inertia: Worth
    gravity: Worth

    @property
    def warning(self) -> str:
        """What to know before the model is used for gravity; "" if it is better than CAD."""
        own = self.gravity
        if own.error <= TOLERANCE * own.error_of_cad:
            return ""
        return (
            f"gravity torque of {self.joint}: expected error {own.error:.3g}, CAD's {own.error_of_cad:.3g} of "
            f"{own.value:.4g} N m (N), RMS over the workspace: the sweeps do not determine it; use CAD's, or compare "
            "it with held poses"
        )


@dataclass(frozen=True)
class Observation:
    """Combinations (k, 11 n) of the parameters with their values (k,) and covariance (k, k)."""

    combination: Array
    values: Array
    covariance: Array


def worth(
    robot: Robot, nominal: Array, spread: tuple[float, Array], observed: Observation, parameters: Array
) -> tuple[AxisWorth, ...]:
    """Of parameters (11 n,). `nominal` and `spread` as in `nearest_physical`."""
    poses = _poses(robot)
    seen = nominal_factor(nominal, spread, observed.combination)
    whole = seen @ seen.T + observed.covariance
    innovation = np.linalg.lstsq(whole, observed.values - observed.combination @ nominal, rcond=None)[0]

    def one(rows: Array) -> Worth:
        factor = nominal_factor(nominal, spread, rows)
        crossed = factor @ seen.T
        gained = np.sum(crossed * np.linalg.lstsq(whole, crossed.T, rcond=None)[0].T, axis=1)
        variance = np.maximum(np.sum(factor**2, axis=1) - gained, 0.0)
        mean, own = crossed @ innovation, rows @ (parameters - nominal)
        error, of_cad = (_rms(np.sqrt(variance + (there - mean) ** 2)) for there in (own, np.zeros(len(own))))
        return Worth(_rms(rows @ parameters), _rms(own), error, of_cad)

    def gravity(joint: int) -> Array:
        rows = gravity_rows(robot.chain, robot.gravity, joint, poses)[:, 0]
        return np.hstack([rows, np.zeros((len(rows), len(robot.joints)))])

    axes = enumerate(robot.joints)
    return tuple(AxisWorth(joint, one(axis_rows(robot.chain, k, poses)), one(gravity(k))) for k, joint in axes)


def worse_than_cad(axes: Iterable[AxisWorth]) -> bool:
    """Whether the model is expected to be worse than CAD in the inertia or gravity of an axis."""
    return any(part.error > TOLERANCE * part.error_of_cad for axis in axes for part in (axis.inertia, axis.gravity))


def _poses(robot: Robot) -> Array:
    """(POSES, n) within the limits, half a turn to each side of a joint without."""
    ends = [(joint.lower, joint.upper) for joint in robot.chain.joints]
    low, high = np.array([(low, high) if np.isfinite(low + high) else (-np.pi, np.pi) for low, high in ends]).T
    return np.random.default_rng(1).uniform(low, high, (POSES, len(ends)))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
