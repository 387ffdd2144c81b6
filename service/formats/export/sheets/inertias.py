r"""The inertia about an axis from base parameters, anywhere in the workspace.

With base parameters beta, their covariance C and the rows W of the poses (`service.identification.model`)

    J = W beta,   cov J = W C W^T
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.model.base_parameters import BaseParameters, base_parameters
from service.identification.model.regressor import lock
from service.model.errors import BadInput
from service.model.results.estimate import Base, BaseParameter, Estimate
from service.model.results.sheet import Sheet, SheetParameter
from service.model.robot import Robot
from service.model.urdf import Chain

Array = NDArray[np.float64]

STILL = 2e-3  # rad (m): smaller differences count as no motion
NO_SHARE = 1e-9  # of a row's largest entry: below, a parameter does not affect the inertia


@dataclass(frozen=True)
class Inertias:
    """Base parameters (r,) of a robot with their covariance (r, r), from an estimate or a sheet.

    `fixed`: positions, rad (m), of the joints that never moved, by index. `place`: prefix of every message.
    """

    robot: Robot
    joints: tuple[str, ...]
    values: Array
    covariance: Array
    opened: tuple[bool, ...]
    fixed: dict[int, float]
    base: BaseParameters
    chain: Chain
    place: str

    def rows(self, joint: str, poses: Array) -> Array:
        """Rows (m, r) of the inertia about `joint` at poses (m, n), rad (m).

        BadInput if the axis was not measured or its inertia is unknown at a pose.
        """
        if joint not in self.joints:
            raise BadInput(self.place, f"did not measure {joint}; it measured {', '.join(self.joints)}")
        for k, position in self.fixed.items():
            if np.abs(poses[:, k] - position).max() > STILL:
                raise BadInput(self.place, f"was measured only with {self.robot.joints[k]} at {position:.4g} rad (m)")
        rows, opened = self._rows(joint, poses)
        if opened:
            raise BadInput(self.place, f"gives no inertia of {joint} in this pose: {opened} is not identified")
        return rows

    def knows(self, joint: str, poses: Array) -> bool:
        """Whether all parameters of the inertia about a measured `joint` at poses (m, n) are identified."""
        return not self._rows(joint, poses)[1]

    def _rows(self, joint: str, poses: Array) -> tuple[Array, str]:
        """Rows (m, r), and the first of their parameters that is not identified, or ""."""
        free = [k for k in range(len(self.robot.joints)) if k not in self.fixed]
        rows = self.base.rows(self.chain, free.index(self.robot.index(joint)), poses[:, free])
        share = np.abs(rows).max(axis=0) > NO_SHARE * np.abs(rows).max()
        left = (name for name, used, opened in zip(self.base.names, share, self.opened, strict=True) if used and opened)
        return rows, next(left, "")


def of_estimate(robot: Robot, estimate: Estimate, place: str) -> Inertias:
    """BadInput if the estimate is of another robot."""
    return _inertias(robot, tuple(estimate.axes), estimate.base_parameters, estimate.base, place)


def of_sheet(robot: Robot, sheet: Sheet, place: str) -> Inertias:
    """BadInput if the sheet is of another robot, or of an old version without covariance."""
    if sheet.base is None:
        raise BadInput(place, "has no covariance of its base parameters: make it again with this version of sweepid")
    joints = tuple(axis.joint for axis in sheet.axes)
    return _inertias(robot, joints, sheet.base_parameters, sheet.base, place)


def _inertias(
    robot: Robot,
    joints: tuple[str, ...],
    parameters: Sequence[BaseParameter | SheetParameter],
    found: Base,
    place: str,
) -> Inertias:
    fixed = {robot.index(name): position for name, position in found.locked.items()}
    free = [k for k in range(len(robot.joints)) if k not in fixed]
    measured = sorted(robot.index(name) for name in joints)
    if not set(measured) <= set(free):
        raise BadInput(f"{place} base.locked", "contains a measured axis")
    chain = lock(robot.chain, fixed)
    base = base_parameters(chain, tuple(free.index(k) for k in measured))
    if tuple(one.name for one in parameters) != base.names:
        raise BadInput(place, f"has other base parameters than robot {robot.name}: its kinematics differ")
    count = len(base.names)
    square = [len(row) for row in found.covariance] == [count] * count  # a file may have rows of any length
    if not square or not np.isfinite(np.array(found.covariance)).all():
        raise BadInput(f"{place} base.covariance", f"must be {count} x {count} finite numbers")
    covariance = np.array(found.covariance, dtype=float).reshape(count, count)
    values = np.array([one.value for one in parameters])
    opened = tuple(one.std is None for one in parameters)
    return Inertias(robot, joints, values, covariance, opened, fixed, base, chain, place)
