"""Observability of the robot with the sweeps of a request: rows in the base parameters, and the workspace."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.axis.nominal_priors import model_spread
from service.identification.estimates.estimate import WORKSPACE
from service.identification.model.base_parameters import base_parameters, joint_ranges, spread_evenly
from service.identification.model.regressor import axis_rows, inertia_rows, lock
from service.model.collision import reachable
from service.model.robot import Robot
from service.planning.documents import PlanRequest

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Observation:
    """The chain as used in the identification: joints that neither move nor vary are locked."""

    robot: Robot
    axes: tuple[int, ...]  # measured joints
    free: tuple[int, ...]  # joints that are not locked
    home: Array
    names: tuple[str, ...]  # base parameters
    columns: tuple[int, ...]
    combination: Array  # (p, 11 n) of the parameters of the free joints in the base parameters

    def rows(self, poses: Array) -> Array:
        """Rows (m, axes, base parameters) at poses (m, n)."""
        chain = lock(self.robot.chain, _locked(self.home, self.free))
        own = [self.free.index(axis) for axis in self.axes]
        return np.stack([axis_rows(chain, k, poses[:, self.free])[:, self.columns] for k in own], axis=1)

    def inertia(self, poses: Array) -> Array:
        """Inertia (m, axes) of the CAD model about the axes, kg m^2 (kg)."""
        chain, parameters = self.robot.chain, self.robot.chain.inertial.ravel()
        motors = [self.robot.axes[axis].reflected_motor_inertia or 0.0 for axis in self.axes]
        return np.stack([inertia_rows(chain, axis, poses) @ parameters for axis in self.axes], axis=1) + motors

    def spread(self, largest: float) -> Array:
        """Standard deviations (p,) of the base parameters in the CAD model, as in the estimate (`base_spread`) if the
        measurement agrees with it; `largest`: inertia for a motor without data sheet, kg m^2 (kg).
        """
        chain = lock(self.robot.chain, _locked(self.home, self.free))
        return model_spread(self.robot, chain, self.free, self.combination, largest)

    def workspace(self, stood: Array) -> Array:
        """Poses (w, n) that represent the workspace, as in the estimate (`Estimate.workspace`)."""
        lower, upper = joint_ranges(lock(self.robot.chain, _locked(self.home, self.free)))
        poses = np.tile(self.home, (WORKSPACE, 1))
        poses[:, self.free] = spread_evenly(WORKSPACE, lower, upper)
        return reachable(self.robot, stood, poses)


def observe(robot: Robot, request: PlanRequest, home: Array) -> Observation:
    """Observability with the sweeps of the request; joints neither measured nor varied are locked at `home` (n,)."""
    axes = tuple(robot.index(joint) for joint in request.axes)
    free = tuple(sorted(robot.index(joint) for joint in {*request.axes, *request.varied}))
    chain = lock(robot.chain, _locked(home, free))
    base = base_parameters(chain, tuple(sorted(free.index(axis) for axis in axes)))
    return Observation(robot, axes, free, home, base.names, base.columns, base.combination)


def _locked(home: Array, free: tuple[int, ...]) -> dict[int, float]:
    return {k: float(position) for k, position in enumerate(home) if k not in free}
