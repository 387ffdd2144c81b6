r"""Drive trains that share one robot: every link feels the others (inertia, Coriolis and centrifugal force, gravity).

    Jm vm' = u - Ts - fm(vm) - cogging(qm)          M(ql) vl' = Ts - fl(vl) - h(ql, vl),      h from MuJoCo

Leapfrog as in `drive_train`, with all friction and damping trapezoidal in one linear system for the new velocities

    (I + D step/2) v+ = (I - D step/2) v- + step force,     I = diag(Jm, M),   D = viscous and structural damping

Coulomb friction: impulses p within +- step Fc that bring v+ to rest where they can, v <- v - K p with the inverse K of
I + D step/2. They are found by projected Jacobi iteration from the last step's, so an axis that slips has its exact
friction at once and one that sticks rests to the iteration's tolerance. While no more than one brake is open, the rows
do not touch each other and the step is that of the single axes.
"""

from collections.abc import Sequence
from typing import Any, cast

import mujoco
import numpy as np
from numpy.typing import NDArray

from simulator.drive_train import DriveTrains
from simulator.moving_axis import MovingAxis, moving_axis
from simulator.rigid_body import RigidBody
from simulator.scenario import Scenario

Array = NDArray[np.float64]

_mujoco = cast(Any, mujoco)  # a binary module without type stubs

_ROUNDS = 4  # of the projected Jacobi iteration, a step
_RELAXATION = 0.7


class Dynamics(RigidBody):
    """The real links in motion."""

    def at(self, pose: Array, velocity: Array) -> tuple[Array, Array]:
        """Inertia matrix (n, n) kg m^2 and bias effort (n,) N m: Coriolis, centrifugal and gravity."""
        model, data = self._model, self._data
        data.qpos[:] = pose
        data.qvel[:] = velocity
        _mujoco.mj_kinematics(model, data)
        _mujoco.mj_comPos(model, data)
        _mujoco.mj_crb(model, data)
        _mujoco.mj_fullM(model, data, self._matrix)
        _mujoco.mj_comVel(model, data)
        bias = np.empty(model.nv)
        _mujoco.mj_rne(model, data, 0, bias)
        return self._matrix, bias


class CoupledTrains(DriveTrains):
    """The driven axes of one robot, one row each; the other joints and those whose brake is closed stand."""

    def __init__(self, scenario: Scenario, step: float) -> None:
        self._body = Dynamics(scenario)
        self._scenario = scenario
        self._driven = [number for number, joint in enumerate(scenario.joints) if joint in scenario.axes]
        self.joints = tuple(scenario.joints[number] for number in self._driven)
        self._standing = np.zeros(len(scenario.joints))
        axes = self.axes
        super().__init__(axes, step)
        rows = len(axes)
        motors = np.diag([axis.motor_inertia for axis in axes])
        self._mass = np.zeros(
            (self.velocity.size, self.velocity.size)
        )  # of the motors; the links' changes with the pose
        self._mass[:rows, :rows] = motors
        self._resistance = np.diag(self._viscous.ravel())
        if self.elastic:
            springs = np.diag(self.damping)
            self._resistance += np.block([[springs, -springs], [-springs, springs]])
        self._resistance *= step / 2
        self._links = slice(self.velocity.size - rows, None)
        self._before = self.velocity[-1].copy()  # of the load, a step ago
        self._impulse = np.zeros(self.velocity.size)

    def stand(self, pose: Array) -> None:
        """Put the whole robot, all brakes closed, into a pose (all joints,) rad."""
        self.position[:] = pose[self._driven]
        self.take_pose(pose)

    def take_pose(self, pose: Array) -> None:
        """Take over the pose (all joints,) for what no state holds: joints without drive, and axes that move alone."""
        self._standing[:] = pose
        self.load(self.axes)

    def settle(self, row: int) -> float:
        """As for a single axis, gravity being that of the present pose of all joints."""
        self._before[row] = 0.0
        self._impulse.reshape(self.velocity.shape)[:, row] = 0.0
        if self.elastic:
            self.position[1, row] = self.position[0, row]
            for _ in range(30):  # contracts by gravity stiffness over spring stiffness
                twist = self.position[0, row] - self.position[1, row]
                stiffness = self._stiffness[row] + self._hardening[row] * twist**2
                self.position[1, row] = self.position[0, row] - self._gravity_now()[row] / stiffness
        self.velocity[:, row] = 0.0
        if self._bristles is not None:
            self._bristles.deflection[row] = 0.0
        return float(self._gravity_now()[row])

    def step(self, effort: Array) -> None:
        """Advance all rows by one step under motor torque `effort` (rows,), N m."""
        free = np.flatnonzero(self.free)
        step, velocity = self._step, self.velocity
        now = 1.5 * velocity[-1] - 0.5 * self._before  # velocities are half a step old
        self._before = velocity[-1].copy()
        if len(free) < 2:
            super().step(effort)
            return
        inertia, bias = self._dynamics(now)
        motor = effort
        if self._cogging is not None:
            motor = motor - self._cogging(self.position[0])
        if self._bristles is not None:
            motor = motor - self._bristles.step(velocity[0])
        mass, drag, old = self._mass.copy(), self._resistance, velocity.ravel()
        mass[self._links, self._links] += inertia
        if self.elastic:
            spring = self.spring_torque()
            force = np.concatenate([motor - spring, spring - bias])
        else:
            force = motor - bias
        moving = slice(None)
        if len(free) < len(self.free):
            moving = np.flatnonzero(np.tile(self.free, len(velocity)))
            chosen = np.ix_(moving, moving)
            mass, drag, old, force = mass[chosen], drag[chosen], old[moving], force[moving]
        gain: Array = np.asarray(np.linalg.inv(mass + drag), dtype=float)
        new = self._rub(gain @ ((mass - drag) @ old + step * force), gain, moving)
        velocity[:] = 0.0
        velocity.reshape(-1)[moving] = new
        self.position[:] += step * velocity

    def _rub(self, velocity: Array, gain: Array, moving: slice | NDArray[np.int_]) -> Array:
        """Velocities (k,) of the moving masses after dry friction."""
        most = self._step * self._coulomb.ravel()[moving]
        impulse = np.clip(self._impulse[moving], -most, most)
        rubbed = velocity - gain @ impulse
        relax = _RELAXATION / np.diag(gain)
        for _ in range(_ROUNDS):
            before = impulse
            impulse = np.minimum(np.maximum(impulse + relax * rubbed, -most), most)
            if np.array_equal(impulse, before):  # every axis slips
                break
            rubbed = velocity - gain @ impulse
        self._impulse[moving] = impulse
        return rubbed

    def _dynamics(self, load_velocity: Array) -> tuple[Array, Array]:
        """Inertia matrix (rows, rows) and bias (rows,) of the driven joints at the present load positions."""
        pose, velocity = self._standing.copy(), np.zeros_like(self._standing)
        pose[self._driven] = self.position[-1]
        velocity[self._driven] = load_velocity * self.free
        inertia, bias = self._body.at(pose, velocity)
        return inertia[np.ix_(self._driven, self._driven)], bias[self._driven]

    def _gravity_now(self) -> Array:
        return self._dynamics(np.zeros(len(self._driven)))[1]

    @property
    def axes(self) -> Sequence[MovingAxis]:
        """The driven axes in the present pose, each alone."""
        pose = self._standing.tolist()
        return [moving_axis(self._scenario, self._body, joint, pose) for joint in self.joints]
