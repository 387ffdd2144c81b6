r"""Standard parameters of every link and motor of a robot, from an estimate that determines only combinations of them.

They are the physical parameters closest to the nominal model that give the identified base parameters
(`physical_consistency`). If that robot is expected to be worse than CAD in the inertia or the gravity of an axis,
because uncertain base parameters are reproduced exactly at the cost of what the sweeps do not determine, they are the
most probable ones instead. Links after joints that never moved are included: the identified parameters of such a rigid
group are distributed among its links by the same rule.

What a rigid model is worth where it is used: inertia and gravity torque of each axis over the workspace.

The sweeps determine combinations b of the parameters x, with covariance C; the others are CAD's x0. With P the prior's
covariance, in which mass, centre and inertia of a link are correlated as in the nearest physical robot
(`physical_consistency`), and K the combinations, a torque t = h x has given the sweeps

    mean t0 + h P K' (K P K' + C)^-1 (b - K x0),    variance  h P h' - h P K' (K P K' + C)^-1 K P h'.

The expected error of any model, of the exported one as of CAD, is the root of this variance and of the square of the
model's distance from this mean. That of gravity contains the error of held-out free motion as well, since what no
rigid robot does, such as a counterbalance, may be a torque of the pose. A physical model with exactly the combinations
b may be farther from this mean than CAD.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from service.identification.estimates.estimate import AxisEstimate, RobotEstimate
from service.identification.model import Solution, axis_rows, fold, gravity_rows
from service.identification.model.physical_consistency import (
    NearestPhysical,
    SearchEnded,
    nearest_physical,
    nominal_factor,
)
from service.model import INERTIAL_NAMES, Array, Robot
from service.model.results import combination as results

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
    """An axis, with what the model is worth for it; `not_held`: gravity torque by which the model is off the estimate,
    N m (N), RMS over the workspace.
    """

    joint: str
    inertia: Worth
    gravity: Worth
    not_held: float = 0.0

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
class ObservedCombinations:
    """Combinations (k, 11 n) of the parameters with their values (k,) and covariance (k, k)."""

    combination: Array
    values: Array
    covariance: Array


@dataclass(frozen=True)
class NominalModel:
    """Parameters (11 n,) of a robot before its sweeps, and their spread as in `nearest_physical`."""

    robot: Robot
    parameters: Array
    spread: tuple[float, Array]

    @cached_property
    def _rows(self) -> tuple[tuple[Array, Array], ...]:
        """Rows over the workspace (m, 11 n) with their `nominal_factor`: inertia and gravity of each axis in turn."""
        robot, poses = self.robot, _poses(self.robot)
        found: list[Array] = []
        for k in range(len(robot.joints)):
            gravity = gravity_rows(robot.chain, robot.gravity, k, poses)[:, 0]
            still = np.zeros((len(gravity), len(robot.joints)))
            found += [axis_rows(robot.chain, k, poses), np.hstack([gravity, still])]
        return tuple((rows, nominal_factor(self.parameters, self.spread, rows)) for rows in found)

    def worth(
        self, observed: ObservedCombinations, parameters: Array, unpredicted: Array | None = None
    ) -> tuple[AxisWorth, ...]:
        """Of `parameters` (11 n,); `unpredicted` (n,): RMS of held-out efforts, N m (N)."""
        beside = np.zeros(len(self.robot.joints)) if unpredicted is None else unpredicted
        seen = nominal_factor(self.parameters, self.spread, observed.combination)
        whole = seen @ seen.T + observed.covariance
        innovation = np.linalg.lstsq(whole, observed.values - observed.combination @ self.parameters, rcond=None)[0]

        def one(rows: Array, factor: Array, beside: float) -> Worth:
            crossed = factor @ seen.T
            gained = np.sum(crossed * np.linalg.lstsq(whole, crossed.T, rcond=None)[0].T, axis=1)
            variance = np.maximum(np.sum(factor**2, axis=1) - gained, 0.0)
            mean, own = crossed @ innovation, rows @ (parameters - self.parameters)
            variance = variance + beside**2
            error, of_cad = (_rms(np.sqrt(variance + (there - mean) ** 2)) for there in (own, np.zeros(len(own))))
            return Worth(_rms(rows @ parameters), _rms(own), error, of_cad)

        parts = np.stack([0 * beside, beside], -1).ravel().tolist()  # inertia and gravity in turn
        found = [one(*rows, own) for rows, own in zip(self._rows, parts, strict=True)]
        off = observed.values - observed.combination @ parameters
        not_held = [
            _rms(np.linalg.lstsq(observed.combination.T, rows.T, rcond=None)[0].T @ off) for rows, _ in self._rows
        ]
        each = zip(self.robot.joints, found[::2], found[1::2], not_held[1::2], strict=True)
        return tuple(AxisWorth(*one) for one in each)


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


@dataclass(frozen=True)
class StandardModel:
    """The nominal model of the whole robot, and its combinations (r, 11 n) that are an estimate's base parameters."""

    nominal: NominalModel
    combination: Array

    @classmethod
    def of(cls, estimate: RobotEstimate) -> "StandardModel":
        robot = estimate.robot
        combination = estimate.base.combination
        if len(estimate.unlocked) < len(robot.axes):
            position = estimate.poses.mean(axis=0)
            locked = {k: float(position[k]) for k in range(len(robot.axes)) if k not in estimate.unlocked}
            combination = combination @ fold(robot.chain, locked)
        motors, motor_spread = _nominal_motors(estimate)
        parameters, spread = np.concatenate([robot.chain.inertial.ravel(), motors]), (robot.prior.inertia, motor_spread)
        return cls(NominalModel(robot, parameters, spread), combination)

    def parameters(self, rows: Array, solution: Solution) -> NearestPhysical:
        """Of the whole robot, from `rows` (m, r) of all sweeps; a motor whose inertia is neither known nor measured
        stays 0.
        """
        seen, nominal, spread = _seen(rows), self.nominal.parameters, self.nominal.spread
        combination, values = seen @ self.combination, seen @ solution.values
        observed = ObservedCombinations(combination, values, seen @ solution.covariance @ seen.T)
        found = nearest_physical(nominal, spread, combination, values, observed.covariance)
        exact = found.ended is SearchEnded.EXACT
        if exact and worse_than_cad(self.nominal.worth(observed, found.parameters)):
            return nearest_physical(nominal, spread, combination, values, observed.covariance, exactly=False)
        return found


def standard_parameters(estimate: RobotEstimate) -> NearestPhysical:
    """Of an estimate's whole robot."""
    return StandardModel.of(estimate).parameters(np.vstack(list(estimate.observation.values())), estimate.solution)


def _seen(rows: Array) -> Array:
    """Combinations (k, r) of the r base parameters that are determined by the rows (m, r)."""
    length = np.linalg.norm(rows, axis=0)
    _, singular, directions = np.linalg.svd(rows / np.where(length > 0, length, 1.0), full_matrices=False)
    # the poses determine the combinations above it
    return np.asarray(directions[singular > 1e-6 * singular[0]] * length, dtype=float)


def _nominal_motors(estimate: RobotEstimate) -> tuple[Array, Array]:
    """Reflected inertia and its relative standard deviation, (n,) each."""
    nominal = np.array([axis.reflected_motor_inertia or 0.0 for axis in estimate.robot.axes])
    spread = np.full(len(nominal), estimate.robot.prior.motor_inertia)
    for axis in estimate.axes:
        number = estimate.robot.index(axis.joint)
        if nominal[number] == 0:
            # relative; no data sheet gives it
            nominal[number], spread[number] = _measured_motor(axis), 1.0
    return nominal, spread


def _measured_motor(axis: AxisEstimate) -> float:
    """Motor inertia from the joint fit, which separates rotor and links; half of the axis inertia if it cannot."""
    if axis.fit is not None and axis.fit.train.motor_inertia > 0:
        return axis.fit.train.motor_inertia
    return abs(float(np.median([sweep.value for sweep in axis.sweeps]))) / 2


def standard_document(robot: Robot, standard: NearestPhysical) -> results.StandardParameters:
    """Parameters of all links and motors of the robot, by name."""
    joints = robot.chain.joints
    count = 10 * len(joints)
    return results.StandardParameters(
        links={
            joint.link: dict(zip(INERTIAL_NAMES, values.tolist(), strict=True))
            for joint, values in zip(joints, standard.parameters[:count].reshape(-1, 10), strict=True)
        },
        motor_inertias={
            f"Jm({joint.name})": float(value) for joint, value in zip(joints, standard.parameters[count:], strict=True)
        },
    )


def physical_document(standard: NearestPhysical) -> results.Physical:
    """`warning` where the search of the most probable robot did not converge."""
    warning = standard.ended.value if standard.ended is SearchEnded.UNFINISHED else ""
    return results.Physical(deviation_in_std=standard.deviation).with_nonempty(warning=warning)
