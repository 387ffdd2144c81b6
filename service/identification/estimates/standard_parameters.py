"""Standard parameters of every link and motor of a robot, from an estimate that knows combinations of them only.

They are those nearest to the nominal model that are physical and give the identified base parameters
(`physical_consistency`). Joints that never moved in the campaign are no reason to give up on the links beyond them:
what was identified of such a rigid group is shared out among its links by the same rule.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.estimates.estimate import AxisEstimate, Estimate
from service.identification.model.physical_consistency import nearest_physical
from service.identification.model.regressor import fold

Array = NDArray[np.float64]

SEEN = 1e-6  # of the largest singular value: a combination of base parameters that the poses tell
UNKNOWN_ROTOR = 1.0  # relative standard deviation of a motor inertia that no data sheet gives


@dataclass(frozen=True)
class StandardParameters:
    """parameters (11 n,) of all the robot's joints, links first; `deviation` of what they give from what was found, in
    standard deviations (Mahalanobis over all base parameters): 0 unless nothing physical gives the estimate."""

    parameters: Array
    deviation: float


def standard_parameters(estimate: Estimate) -> StandardParameters:
    """Of the whole robot; a motor whose inertia is neither known nor measured stays 0."""
    robot = estimate.robot
    combination = estimate.base.combination
    if len(estimate.unlocked) < len(robot.axes):
        position = estimate.poses.mean(axis=0)
        locked = {k: float(position[k]) for k in range(len(robot.axes)) if k not in estimate.unlocked}
        combination = combination @ fold(robot.chain, locked)
    seen = _seen(np.vstack(list(estimate.observation.values())))
    motors, spread = _nominal_motors(estimate)
    found = nearest_physical(
        np.concatenate([robot.chain.inertial.ravel(), motors]),
        (robot.prior.inertia, spread),
        seen @ combination,
        seen @ estimate.solution.values,
        seen @ estimate.solution.covariance @ seen.T,
    )
    return StandardParameters(found.parameters, found.deviation)


def _seen(rows: Array) -> Array:
    """Combinations (k, r) of the r base parameters that the observed rows (m, r) tell."""
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
    """What the joint fit told rotor and links apart by; half of the axis inertia where it has nothing to say."""
    if axis.fit is not None and axis.fit.train.motor_inertia > 0:
        return axis.fit.train.motor_inertia
    return abs(float(np.median([sweep.value for sweep in axis.sweeps]))) / 2
