"""Standard parameters of every link and motor of a robot, from an estimate that determines only combinations of them.

They are the physical parameters closest to the nominal model that give the identified base parameters
(`physical_consistency`). If that robot is expected to be worse than CAD in the inertia or the gravity of an axis,
because uncertain base parameters are reproduced exactly at the cost of what the sweeps do not determine, they are the
most probable ones instead. Links after joints that never moved are included: the identified parameters of such a rigid
group are distributed among its links by the same rule.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.estimates.combination import Combination
from service.identification.estimates.estimate import AxisEstimate, Estimate
from service.identification.estimates.worth import Observation, worse_than_cad, worth
from service.identification.model.base_parameters import joint_ranges
from service.identification.model.physical_consistency import Ended, nearest_physical
from service.identification.model.regressor import fold, inertia_rows

Array = NDArray[np.float64]

SEEN = 1e-6  # of the largest singular value: a combination of base parameters above it is determined by the poses
LEAST_ROTOR = 0.1  # of the inertia of its axis: a motor that no data sheet gives
UNKNOWN_ROTOR = 1.0  # relative standard deviation of a motor inertia that no data sheet gives


@dataclass(frozen=True)
class StandardParameters:
    """parameters (11 n,) of all the robot's joints, links first; `deviation` of base parameters from the estimate,
    in standard deviations (Mahalanobis over all base parameters): 0 if the estimate is physical; `ended`:
    reason for the end of the search."""

    parameters: Array
    deviation: float
    ended: Ended


def standard_parameters(estimate: Estimate) -> StandardParameters:
    """Parameters of the whole robot; a motor whose inertia is neither known nor measured stays 0."""
    robot = estimate.robot
    combination = estimate.base.combination
    if len(estimate.unlocked) < len(robot.axes):
        position = estimate.poses.mean(axis=0)
        locked = {k: float(position[k]) for k in range(len(robot.axes)) if k not in estimate.unlocked}
        combination = combination @ fold(robot.chain, locked)
    seen = _seen(np.vstack(list(estimate.observation.values())))
    motors, motor_spread = _nominal_motors(estimate)
    nominal, spread = np.concatenate([robot.chain.inertial.ravel(), motors]), (robot.prior.inertia, motor_spread)
    values, covariance = seen @ estimate.solution.values, seen @ estimate.solution.covariance @ seen.T
    found = nearest_physical(nominal, spread, seen @ combination, values, covariance)
    if found.ended is Ended.EXACT:
        observed = Observation(seen @ combination, values, covariance)
        if worse_than_cad(worth(robot, nominal, spread, observed, found.parameters)):
            found = nearest_physical(nominal, spread, seen @ combination, values, covariance, exactly=False)
    return StandardParameters(found.parameters, found.deviation, found.ended)


def combined_parameters(found: Combination) -> StandardParameters:
    """Parameters of the whole robot. A motor without data sheet is nominally what its axis has more than the links of
    CAD, a tenth of it at least.
    """
    robot, count = found.robot, 11 * len(found.robot.axes)
    own = np.array(found.base.columns) < count
    middle = np.mean(joint_ranges(robot.chain), axis=0)[None]
    nominal, spread = np.zeros(len(robot.axes)), np.full(len(robot.axes), UNKNOWN_ROTOR)
    for k, axis in enumerate(robot.axes):
        if axis.reflected_motor_inertia:
            nominal[k], spread[k] = axis.reflected_motor_inertia, robot.prior.motor_inertia
            continue
        whole = abs(float(found.inertia(axis.joint, middle)[0]))
        links = float((inertia_rows(robot.chain, k, middle) @ robot.chain.inertial.ravel())[0])
        nominal[k] = max(whole - links, LEAST_ROTOR * whole)
    physical = nearest_physical(
        np.concatenate([robot.chain.inertial.ravel(), nominal]),
        (robot.prior.inertia, spread),
        found.base.combination[own, :count],
        found.solution.values[own],
        found.solution.covariance[np.ix_(own, own)],
    )
    return StandardParameters(physical.parameters, physical.deviation, physical.ended)


def _seen(rows: Array) -> Array:
    """Combinations (k, r) of the r base parameters that are determined by the rows (m, r)."""
    length = np.linalg.norm(rows, axis=0)
    _, singular, directions = np.linalg.svd(rows / np.where(length > 0, length, 1.0), full_matrices=False)
    return np.asarray(directions[singular > SEEN * singular[0]] * length, dtype=float)


def _nominal_motors(estimate: Estimate) -> tuple[Array, Array]:
    """Reflected inertia and its relative standard deviation, (n,) each."""
    nominal = np.array([axis.reflected_motor_inertia or 0.0 for axis in estimate.robot.axes])
    spread = np.full(len(nominal), estimate.robot.prior.motor_inertia)
    for axis in estimate.axes:
        number = estimate.robot.index(axis.joint)
        if nominal[number] == 0:
            nominal[number], spread[number] = _measured_motor(axis), UNKNOWN_ROTOR
    return nominal, spread


def _measured_motor(axis: AxisEstimate) -> float:
    """Motor inertia from the joint fit, which separates rotor and links; half of the axis inertia if it cannot."""
    if axis.fit is not None and axis.fit.train.motor_inertia > 0:
        return axis.fit.train.motor_inertia
    return abs(float(np.median([sweep.value for sweep in axis.sweeps]))) / 2
