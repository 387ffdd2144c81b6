"""What an exported model is worth over the workspace, from the document of its estimate."""

import numpy as np
from numpy.typing import NDArray

from service.identification.estimates.standard_parameters import AxisWorth, ObservedCombinations, worth
from service.identification.model.base_parameters import base_parameters
from service.identification.model.regressor import fold, lock
from service.model.results.estimate import Estimate
from service.model.robot import Robot

Array = NDArray[np.float64]


def worth_of(robot: Robot, found: Estimate, parameters: Array) -> tuple[AxisWorth, ...]:
    """Of the parameters (11 n,) of an estimate; empty if it determines none, or is of another robot."""
    fixed = {robot.index(joint): position for joint, position in found.base.locked.items()}
    left = [k for k in range(len(robot.joints)) if k not in fixed]
    moved = sorted(robot.index(joint) for joint in found.axes)
    known = [k for k, one in enumerate(found.base_parameters) if one.std is not None]
    if not moved or not known or not set(moved) <= set(left):
        return ()
    own = base_parameters(lock(robot.chain, fixed), tuple(left.index(k) for k in moved))
    stated = found.base_parameters
    if tuple(one.name for one in stated) != own.names:
        return ()
    whole = np.array(found.base.covariance, dtype=float)
    if whole.shape != (len(stated), len(stated)):
        whole = np.diag([(one.std or 0.0) ** 2 for one in stated])
    combination = own.combination[known] @ fold(robot.chain, fixed)
    values = np.array([stated[k].value for k in known])
    motors = np.array([axis.reflected_motor_inertia or 0.0 for axis in robot.axes])
    unknown = motors == 0
    motors[unknown] = parameters[-len(motors) :][unknown]
    nominal = np.concatenate([robot.chain.inertial.ravel(), motors])
    spread = robot.prior.inertia, np.where(unknown, 1.0, robot.prior.motor_inertia)
    observed = ObservedCombinations(combination, values, whole[np.ix_(known, known)])
    return worth(robot, nominal, spread, observed, parameters)
