r"""Drive trains that share one robot: every link feels the others (inertia, Coriolis and centrifugal force, gravity).

    Jm vm' = u - Ts - fm(vm) - cogging(qm)          M(ql) vl' = Ts - fl(vl) - h(ql, vl),      h from MuJoCo

Leapfrog as in `drive_train`, with all friction and damping trapezoidal in one linear system for the new velocities:

    (I + D step/2) v+ = (I - D step/2) v- + step force,     I = diag(Jm, M),   D = viscous and structural damping

Coulomb friction: impulses p within +- step Fc that bring v+ to rest where they can, v <- v - K p with the inverse K of
I + D step/2. They are found by projected Jacobi iteration from the last step's, so an axis that slips has its exact
friction at once and one that sticks rests to the iteration's tolerance. While no more than one brake is open, the rows
do not touch each other and the step is that of the single axes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.drive_train import DriveTrains, TrainAlone
from simulator.rigid_body import MovingAxis, RigidBody, moving_axis
from simulator.scenario import Scenario
from simulator.waveform import Array


@dataclass(frozen=True, slots=True)
class _Masses:
    """Response of the masses (k,) that may move to a force."""

    free: Array  # state of the brakes for which this was computed
    moving: NDArray[np.int_]  # their indices among all masses
    momentum: Array  # (k, k) inertia minus half a step of damping
    gain: Array  # (k, k) inverse of inertia plus half a step of damping
    relax: Array  # (k,) of the projected Jacobi iteration


class CoupledTrains(DriveTrains):
    """The driven axes of one robot, one row each. The other joints and those with a closed brake stand."""

    rounds = 4
    """Of the projected Jacobi iteration per step."""
    kept = 4
    """Steps with a constant inertia matrix: one cycle of 1 ms, in which the pose hardly changes."""

    def __init__(self, scenario: Scenario, step: float) -> None:
        self._body = RigidBody(scenario)
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
        )  # of the motors; that of the links changes with the pose
        self._mass[:rows, :rows] = motors
        self._resistance = self._resist(self.damping, np.ones(rows))
        self._links = slice(self.velocity.size - rows, None)
        self._before = self.velocity[-1].copy()  # of the load, one step before
        self._impulse = np.zeros(self.velocity.size)
        self._answering: _Masses | None = None
        self._age = 0  # steps of the masses
        self._dry = step * np.stack([-self._coulomb.ravel(), self._coulomb.ravel()])  # impulses of plain friction

    def _resist(self, damping: Array, lever: Array) -> Array:
        """Half a step of viscous friction and of the `damping` (rows,) of the springs, a matrix over all masses."""
        resistance = np.diag(self._viscous.ravel())
        if self.elastic:
            both, across, load = (np.diag(damping * lever**power) for power in (2, 1, 0))
            resistance += np.block([[both, -across], [-across, load]])
        return resistance * self._step / 2

    def stand(self, pose: Array) -> None:
        """Put the whole robot, all brakes closed, into a pose (all joints,) rad."""
        self.position[:] = pose[self._driven]
        self.take_pose(pose)

    def take_pose(self, pose: Array) -> None:
        """Take the pose (all joints,) of joints that have no state here: joints without drive, and axes that move
        alone.
        """
        self._standing[:] = pose
        self.load(self.axes)

    def settle(self, row: int) -> float:
        """As for a single axis; the friction state of the row is reset."""
        self._before[row] = 0.0
        self._impulse.reshape(self.velocity.shape)[:, row] = 0.0
        return super().settle(row)

    def step(self, effort: Array) -> None:
        """Advance all rows by one step under motor torque `effort` (rows,), N m."""
        step, velocity = self._step, self.velocity
        now = 1.5 * velocity[-1] - 0.5 * self._before  # velocities lag by half a step
        self._before = velocity[-1].copy()
        if not self._touching():
            self._answering = None
            super().step(effort)
            return
        inertia, bias = self._dynamics(now)
        masses = self._answer(inertia)
        motor = self.motor_torque(effort)
        if self.appendages is not None:
            bias = bias + self.appendages.step(self.position[-1], velocity[-1])
        if self.elastic:
            spring = self.spring_torque()
            force = np.concatenate([motor - self.lever() * spring, spring - bias])
        else:
            force = motor - bias
        dry = self._dry
        if self.friction is not None:
            forward, backward, more = self.rub()
            force = force - more.ravel()
            dry = step * np.stack([-backward.ravel(), forward.ravel()])
        moving, old = masses.moving, velocity.ravel()[masses.moving]
        new = self._rub(masses.gain @ (masses.momentum @ old + step * force[moving]), masses, dry[:, moving])
        velocity[:] = 0.0
        velocity.reshape(-1)[moving] = new
        self.position[:] += step * velocity

    def alone(self) -> dict[int, TrainAlone] | None:
        """As for single axes, while no axis is coupled to another."""
        return None if self._touching() else super().alone()

    def take_back(self, row: int, alone: TrainAlone) -> None:
        """As for single axes."""
        super().take_back(row, alone)
        self._before[row], self._answering = alone.before, None

    def _touching(self) -> bool:
        return self._scenario.coupled and int(np.count_nonzero(self.free)) > 1

    def _answer(self, inertia: Array) -> _Masses:
        """Masses of this step, reused for some steps if allowed."""
        self._age += 1
        masses = self._answering
        changing = self._has_gap or self.gear_error is not None  # changes in every step
        stale = changing or self._age >= self.kept
        if masses is None or stale or (masses.free != self.free).any():
            mass, drag = self._mass.copy(), self._resistance
            mass[self._links, self._links] += inertia[np.ix_(self._driven, self._driven)]
            if changing:
                drag = self._resist(self.damping * self.engaged(), self.lever())
            moving = np.flatnonzero(np.tile(self.free, len(self.velocity)))
            mass, drag = mass[np.ix_(moving, moving)], drag[np.ix_(moving, moving)]
            gain: Array = np.asarray(np.linalg.inv(mass + drag), dtype=float)
            relax = 0.7 / np.diag(gain)
            self._answering = masses = _Masses(self.free.copy(), moving, mass - drag, gain, relax)
            self._age = 0
        return masses

    def _rub(self, velocity: Array, masses: _Masses, dry: Array) -> Array:
        """Velocities (k,) of the moving masses after dry friction with impulses `dry` (2, k): minimum and maximum."""
        least, most = dry
        impulse = np.minimum(np.maximum(self._impulse[masses.moving], least), most)
        rubbed = velocity - masses.gain @ impulse
        for _ in range(self.rounds):
            before = impulse
            impulse = np.minimum(np.maximum(impulse + masses.relax * rubbed, least), most)
            if (impulse == before).all():  # every axis slips
                break
            rubbed = velocity - masses.gain @ impulse
        self._impulse[masses.moving] = impulse
        return rubbed

    def _dynamics(self, load_velocity: Array) -> tuple[Array, Array]:
        """Inertia matrix (n, n) of all joints and bias (rows,) of the driven ones at the present load positions."""
        pose, velocity = self._standing.copy(), np.zeros_like(self._standing)
        pose[self._driven] = self.position[-1]
        velocity[self._driven] = load_velocity * self.free
        inertia, bias = self._body.at(pose, velocity)
        bias = bias[self._driven]
        return inertia, bias + self.hose_torque() if self._has_hose else bias

    def holding_torque(self) -> Array:
        """As for single axes, with gravity in the present pose of all joints."""
        return self._dynamics(np.zeros(len(self._driven)))[1]

    @property
    def axes(self) -> Sequence[MovingAxis]:
        """The driven axes in the present pose, each as a single axis."""
        pose = self._standing.tolist()
        return [moving_axis(self._scenario, self._body, joint, pose) for joint in self.joints]
