"""The safety envelope: which motion is allowed, checked before and during motion. Pure: no I/O, no clock, no state.

Before a sweep, from its command alone (bounds apply to every instant, including ramps):

    travel      v0 (ramp + settle + P T) in either direction,  the sines add at most  sum a_i / (pi f_i)
                (second mean value theorem: the envelope e(t) rises, holds and falls, 0 <= e <= 1)
    velocity    |v0| + sum a_i
    effort      (1 + 2 s_J) J_cad a_max + (1 + s_g) |gravity|_max + (1 + s_v) mu_v v_max
                + breakaway share of the rated effort

with s the robot's prior. Torque noise of n lines has the amplitude a = f sqrt(2/n) at each, f the RMS. With the least
inertia J that the prior allows, whose motion the speed control only reduces, it adds

    velocity    sum a / (2 pi f_k J)
    travel      sum a / ((2 pi f_k)^2 J)   in either direction

A violation names axis, quantity, value, limit and unit. Limits that a drive enforces in addition
are handled by the adapter; nothing here depends on them.
"""

import math
from collections.abc import Collection, Sequence
from itertools import product

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from drivers.errors import CauseCode, Measured, distinct
from drivers.ports import NoiseCommand, SampleBlock, SineCommand, SweepCommand
from service import EnvelopeViolation
from service.identification.design.excitation import Excitation, Sines, velocity_setpoint, way
from service.identification.design.exciting_trajectory import BREAKAWAY, nominal_effort
from service.identification.estimates.torque_gain import KnownMass
from service.identification.model import JointMotion, gravity_terms, inertia_rows
from service.model import Array, Robot, Sine
from service.model.collision import CollisionChecker
from service.model.configuration import Cell
from service.planning.safety.travel import Leg, route

Command = SweepCommand | NoiseCommand


class MethodLimits(BaseModel):
    """Limits of the method; the limits of the robot's joints and of the cell apply in addition."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    travel: float = Field(default=Sines.travel, gt=0)  # rad (m), maximum travel of a sweep, including settling
    window_margin: float = Field(default=math.radians(0.25), gt=0)  # rad (m), additional margin for the control error
    sweep_velocity: float = Field(default=0.1, gt=0)  # rad/s (m/s), at any instant of a sweep
    trajectory_velocity: float = Field(default=0.8, gt=0)  # rad/s (m/s), amplitudes of several axes' sweeps summed up
    trajectory_deviation: float = Field(default=0.02, gt=0)  # rad (m), of an axis from its path
    move_velocity: float = Field(default=0.5, gt=0)  # rad/s (m/s), between poses
    sweep_duration: float = Field(default=120.0, gt=0)  # s
    breakaway: float = Field(default=BREAKAWAY, ge=0)  # Coulomb friction to add, share of the rated effort


class Envelope:
    """Allowed motion of one robot in one cell. Every check raises EnvelopeViolation or returns None."""

    def __init__(
        self, robot: Robot, cell: Cell, limits: MethodLimits | None = None, test_mass: KnownMass | None = None
    ) -> None:
        """`test_mass`: mounted while this envelope is used. Its weight counts; its shape is not checked for
        collision.
        """
        self.limits = limits or MethodLimits()
        self._inertial = robot.chain.inertial.ravel().copy()
        if test_mass is not None:
            self._inertial[-10:] += test_mass.parameters
        self.checker = CollisionChecker(robot, cell)
        self._robot = robot
        self._cell = cell
        self._home = cell.home_pose(robot.joints)

    @property
    def joints(self) -> tuple[str, ...]:
        """In the order of poses."""
        return self._robot.joints

    def check_sweep(self, command: Command, pose: Sequence[float]) -> None:
        """Whether this sweep may run from `pose` (n,), the positions of all joints at its start, with the others
        standing.
        """
        joint, limits = command.joint, self.limits
        index = self._index(joint)
        self._check_pose(pose)
        self._check_shape(command)
        low, high, velocity = self._motion(command, pose)
        _at_most(joint, "travel", high - low, limits.travel, self._unit(index))
        window = command.position_window
        reach = limits.travel + limits.window_margin
        for name, value in (("lowest position", pose[index] + low), ("highest position", pose[index] + high)):
            _within(joint, f"{name} of the sweep", value, window, self._unit(index))
        for name, value in (("lower end", window[0]), ("upper end", window[1])):
            here = (pose[index] - reach, pose[index] + reach)
            _within(joint, f"{name} of the position window", value, here, self._unit(index))
            _within(joint, f"{name} of the position window", value, self.joint_range(index), self._unit(index))
        speed = f"{self._unit(index)}/s"
        _at_most(joint, "velocity limit", command.velocity_limit, self.velocity_limit(index), speed)
        _at_most(joint, "peak velocity", velocity, command.velocity_limit, speed)
        _at_most(joint, "effort limit", command.effort_limit, self.effort_limit(index), self._effort_unit(index))
        effort = self.predicted_effort(command, pose)
        _at_most(joint, "predicted peak effort", effort, command.effort_limit, self._effort_unit(index))
        start = list(pose)
        start[index] = window[0]
        if not self.checker.leg_free(start, index, window[1]):
            raise EnvelopeViolation(
                joint,
                f"the sweep's window {window[0]:.4f} to {window[1]:.4f} {self._unit(index)} is not free: "
                f"clearance under {self._cell.clearance} m in cell {self._cell.name}",
                code=CauseCode.PATH_NOT_FREE,
            )

    def check_run(self, commands: Sequence[Command], pose: Sequence[float]) -> None:
        """`check_sweep` of one command, `check_trajectory` of several; noise runs alone."""
        if len(commands) == 1:
            self.check_sweep(commands[0], pose)
            return
        self.check_trajectory([command for command in commands if isinstance(command, SweepCommand)], pose)

    def check_trajectory(self, commands: Sequence[SweepCommand], pose: Sequence[float]) -> None:
        """Whether these sweeps may run together from `pose` (n,). Their windows bound each axis; the path must be free.

        `watch_path` keeps the axes on it. For simultaneous sweeps the limits of a sweep apply, and the paths at all
        corners of what `watch_path` allows must be free as well.
        """
        self._check_pose(pose)
        for command in commands:
            joint, index = command.joint, self._index(command.joint)
            unit = self._unit(index)
            self._check_shape(command)
            for name, value in zip(("lower end", "upper end"), command.position_window, strict=True):
                _within(joint, f"{name} of the position window", value, self.joint_range(index), unit)
            fastest = min(self.limits.trajectory_velocity, self._robot.chain.joints[index].velocity)
            if command.offset_velocity:
                low, high = travel_bounds(command)
                _at_most(joint, "travel", high - low, self.limits.travel, unit)
                fastest = self.velocity_limit(index)
            _at_most(joint, "velocity limit", command.velocity_limit, fastest, f"{unit}/s")
            _at_most(joint, "peak velocity", peak_velocity(command), command.velocity_limit, f"{unit}/s")
            _at_most(joint, "effort limit", command.effort_limit, self.effort_limit(index), self._effort_unit(index))
        motion = commanded_motion(self._robot.joints, commands, pose)
        effort = nominal_effort(self._robot, motion, self.limits.breakaway)
        for command in commands:
            joint, index = command.joint, self._index(command.joint)
            for end in (motion.position[:, index].min(), motion.position[:, index].max()):
                _within(joint, "position on the trajectory", float(end), command.position_window, self._unit(index))
            peak = float(np.abs(effort[:, index]).max())
            _at_most(joint, "predicted peak effort", peak, command.effort_limit, self._effort_unit(index))
        if not all(self.checker.path_free(motion.position + away) for away in self._corners(commands)):
            moving = ", ".join(command.joint for command in commands)
            raise EnvelopeViolation(
                moving,
                f"the trajectory is not free: clearance under {self._cell.clearance} m in cell {self._cell.name}",
                code=CauseCode.PATH_NOT_FREE,
            )

    def check_move(self, joint: str, pose: Sequence[float], target: float, velocity: float) -> None:
        """Whether `joint` may move from `pose` (n,) to `target`, rad (m), at `velocity`, rad/s (m/s), with the others
        standing.
        """
        index = self._index(joint)
        self._check_pose(pose)
        _within(joint, "target", target, self.joint_range(index), self._unit(index))
        limit = min(self.limits.move_velocity, self._robot.chain.joints[index].velocity)
        _at_most(joint, "velocity of the move", velocity, limit, f"{self._unit(index)}/s")
        if not self.checker.leg_free(pose, index, target):
            raise EnvelopeViolation(
                joint,
                f"the path from {pose[index]:.4f} to {target:.4f} {self._unit(index)} is not "
                f"free: clearance under {self._cell.clearance} m in cell {self._cell.name}",
                code=CauseCode.PATH_NOT_FREE,
            )

    def check_standing(
        self, pose: Sequence[float], measured: Sequence[float], tolerance: float, moving: Collection[str] = ()
    ) -> None:
        """Whether all axes but `moving` are at the planned positions, within `tolerance` rad (m)."""
        for index, joint in enumerate(self._robot.joints):
            if joint not in moving:
                _at_most(
                    joint,
                    "distance from the planned pose",
                    abs(measured[index] - pose[index]),
                    tolerance,
                    self._unit(index),
                )

    def watch(self, command: Command, block: SampleBlock) -> None:
        """Whether these samples are within the command's window, velocity and effort. NaN is a violation.

        The load may deviate by the deflection of the drive train: a further `window_margin`.
        """
        index = self._index(block.joint)
        if block.joint != command.joint:
            raise EnvelopeViolation(block.joint, f"moves although {command.joint} is the axis of the sweep")
        unit = self._unit(index)
        low, high = command.position_window
        _all_within(block.joint, "position", block.position, low, high, unit)
        if block.load_position is not None:
            give = self.limits.window_margin
            _all_within(block.joint, "load position", block.load_position, low - give, high + give, unit)
        speed, effort = command.velocity_limit, command.effort_limit
        _all_within(block.joint, "velocity", block.velocity, -speed, speed, f"{unit}/s")
        _all_within(block.joint, "effort", block.effort, -effort, effort, self._effort_unit(index))

    def watch_path(self, command: SweepCommand, start: float, block: SampleBlock) -> None:
        """Whether one axis of a trajectory stays on the checked path. `start`: its position at the start, rad (m)."""
        way = path_of(command, block.time)
        off = block.position - start - way
        limit = self._deviation(command)
        unit = self._unit(self._index(command.joint))
        _all_within(command.joint, "distance from the trajectory", off, -limit, limit, unit)

    def _deviation(self, command: SweepCommand) -> float:
        """Of an axis that moves with others from its path, rad (m): in a sweep that of its window."""
        return self.limits.window_margin if command.offset_velocity else self.limits.trajectory_deviation

    def _corners(self, commands: Sequence[SweepCommand]) -> Array:
        """(c, n) deviations of all joints from the path, the first of none."""
        away = [(-self._deviation(one), self._deviation(one)) if one.offset_velocity else (0.0,) for one in commands]
        corners = np.zeros((1 + math.prod(map(len, away)), len(self.joints)))
        corners[1:, [self._index(one.joint) for one in commands]] = list(product(*away))
        return np.unique(corners, axis=0)

    def order_of_legs(self, start: Sequence[float], goal: Sequence[float]) -> tuple[Leg, ...]:
        """Collision-free legs (number of the joint, target) from one pose to another, each moving one axis."""
        self._check_pose(start)
        self._check_pose(goal)
        legs = route(self.checker, start, goal, self._home)
        if legs is None:
            raise EnvelopeViolation(
                f"no collision-free path of single-axis moves from {_shown(start)} to {_shown(goal)} "
                f"was found in cell {self._cell.name}",
                code=CauseCode.PATH_NOT_FREE,
            )
        return legs

    def predicted_effort(self, command: Command, pose: Sequence[float]) -> float:
        """Upper bound of the effort of the sweep, from the CAD model and its prior, N m (N)."""
        index = self._index(command.joint)
        prior, axis = self._robot.prior, self._robot.axis(command.joint)
        total = (1 + 2 * prior.inertia) * self._cad_inertia(index, pose) + (axis.reflected_motor_inertia or 0.0)
        velocity = self._motion(command, pose)[2]
        friction = (1 + prior.viscous_friction) * (axis.viscous_friction or 0.0) * velocity
        gravity = self.gravity_effort(index, pose, command.position_window)
        noise = noise_effort(command) if isinstance(command, NoiseCommand) else 0.0
        return (
            total * peak_acceleration(command) + friction + gravity + noise + self.limits.breakaway * axis.rated_effort
        )

    def _motion(self, command: Command, pose: Sequence[float]) -> tuple[float, float, float]:
        """Lowest and highest position relative to the start, rad (m), and peak velocity, rad/s (m/s)."""
        low, high = travel_bounds(command)
        if not isinstance(command, NoiseCommand):
            return low, high, peak_velocity(command)
        least = self.least_inertia(self._index(command.joint), pose)
        way = noise_way(command, least)
        return low - way, high + way, peak_velocity(command) + noise_velocity(command, least)

    def _cad_inertia(self, index: int, pose: Sequence[float]) -> float:
        """Inertia about a joint, without its motor, kg m^2 (kg)."""
        chain = self._robot.chain
        return float(inertia_rows(chain, index, np.array([pose]))[0] @ self._inertial)

    def gravity_effort(self, index: int, pose: Sequence[float], window: tuple[float, float]) -> float:
        """Largest effort against gravity over a joint's window, N m (0: prismatic): of the CAD model within its prior,
        with the test mass and the counterbalance.
        """
        poses = np.tile(np.asarray(pose, dtype=float), (5, 1))
        poses[:, index] = np.linspace(window[0], window[1], 5)
        chain = self._robot.chain
        weight = gravity_terms(chain, self._inertial, self._robot.gravity, index, poses)[:, 0]
        carried = self._robot.counterbalance_effort(index, poses[:, index])
        return float((np.abs(weight + carried) + self._robot.prior.gravity * np.abs(weight)).max())

    def least_inertia(self, index: int, pose: Sequence[float]) -> float:
        """Lower bound of the axis' inertia, from the CAD model and its prior, kg m^2 (kg)."""
        motor = self._robot.axes[index].reflected_motor_inertia or 0.0
        # however wide the prior, a link is taken to have a tenth of its inertia in CAD
        return max(1 - 2 * self._robot.prior.inertia, 0.1) * self._cad_inertia(index, pose) + motor

    def joint_range(self, index: int) -> tuple[float, float]:
        """Joint limits minus the cell's margin, rad (m)."""
        joint = self._robot.chain.joints[index]
        return joint.lower + self._cell.joint_margin, joint.upper - self._cell.joint_margin

    def units(self) -> dict[str, str]:
        """The unit of every joint's position, rad or m."""
        return {joint: self._unit(index) for index, joint in enumerate(self._robot.joints)}

    def velocity_limit(self, index: int) -> float:
        """Largest allowed velocity limit of a sweep, rad/s (m/s)."""
        return min(self.limits.sweep_velocity, self._robot.chain.joints[index].velocity)

    def effort_limit(self, index: int) -> float:
        """The joint's effort limit, N m (N)."""
        return self._robot.chain.joints[index].effort

    def _index(self, joint: str) -> int:
        if joint not in self._robot.joints:
            raise EnvelopeViolation(joint, f"robot {self._robot.name} has {', '.join(self._robot.joints)}")
        return self._robot.joints.index(joint)

    def _check_pose(self, pose: Sequence[float]) -> None:
        joints = self._robot.joints
        if len(pose) != len(joints):
            raise EnvelopeViolation(f"pose has {len(pose)} positions, robot {self._robot.name} has {len(joints)} axes")
        for index, joint in enumerate(joints):
            limits = self._robot.chain.joints[index]
            _within(joint, "position", pose[index], (limits.lower, limits.upper), self._unit(index))

    def _check_shape(self, command: Command) -> None:
        """Checks the parameters of a sweep; values that are not finite fail here."""
        sines = _sines(command)
        numbers = [command.offset_velocity, *command.position_window]
        numbers += [number for sine in sines for number in (sine.amplitude, sine.phase)]
        if not all(map(math.isfinite, numbers)):
            raise EnvelopeViolation(command.joint, "a number of the sweep is not finite")
        for name, value in (
            ("ramp", command.ramp),
            ("period", command.period),
            ("sample rate", command.sample_rate),
            *(("frequency", sine.frequency) for sine in sines),
            *_noise_numbers(command),
        ):
            if not 0 < value < math.inf:
                raise EnvelopeViolation(command.joint, f"{name} of the sweep is {value}, must be above 0")
        if not (command.settle >= 0 and command.periods >= 1):
            raise EnvelopeViolation(command.joint, f"{command.periods} periods and {command.settle} s to settle")
        if isinstance(command, NoiseCommand):
            _at_most(command.joint, "softening", command.softening, 1.0, "of the gain")
        _at_most(command.joint, "duration", command.duration, self.limits.sweep_duration, "s")

    def _unit(self, index: int) -> str:
        return "m" if self._robot.chain.joints[index].kind == "prismatic" else "rad"

    def _effort_unit(self, index: int) -> str:
        return "N" if self._robot.chain.joints[index].kind == "prismatic" else "N m"


def travel_bounds(command: Command) -> tuple[float, float]:
    """Lowest and highest position of the set-point relative to the start at any instant, rad (m)."""
    way = command.offset_velocity * (command.ramp + command.settle + command.period * command.periods)
    sines = sum(abs(sine.amplitude) / (math.pi * sine.frequency) for sine in _sines(command))
    return min(0.0, way) - sines, max(0.0, way) + sines


def peak_velocity(command: Command) -> float:
    """Bound of the set-point's velocity, rad/s (m/s)."""
    return abs(command.offset_velocity) + sum(abs(sine.amplitude) for sine in _sines(command))


def peak_acceleration(command: Command) -> float:
    """Bound of the set-point's acceleration, rad/s^2 (m/s^2): the sines, and the steepest part of the ramp."""
    sines = sum(2 * math.pi * sine.frequency * abs(sine.amplitude) for sine in _sines(command))
    return sines + peak_velocity(command) * math.pi / (2 * command.ramp)


def _sines(command: Command) -> tuple[SineCommand, ...]:
    return command.sines if isinstance(command, SweepCommand) else ()


def _noise_numbers(command: Command) -> tuple[tuple[str, float], ...]:
    """Further parameters that must be above 0."""
    if not isinstance(command, NoiseCommand):
        return ()
    below = command.sample_rate / 2 - command.highest
    return (
        ("effort", command.effort),
        ("lowest frequency", command.lowest),
        ("width of the band", command.highest - command.lowest),
        ("distance of the band from half the sample rate", below),
        ("softening", command.softening),
    )


def noise_velocity(command: NoiseCommand, inertia: float) -> float:
    """Bound of the noise's part of the velocity, rad/s (m/s); `inertia` kg m^2 (kg)."""
    omega = _omega(command)
    return _amplitude(command) * float(np.sum(1 / omega)) / inertia


def noise_way(command: NoiseCommand, inertia: float) -> float:
    """Bound of the travel by the noise in either direction, rad (m)."""
    omega = _omega(command)
    return _amplitude(command) * float(np.sum(1 / omega**2)) / inertia


def noise_effort(command: NoiseCommand) -> float:
    """Bound of the effort with this noise, N m (N).

    The response of the speed control is part of the effort: at most twice the injected torque.
    """
    return 2.0 * _amplitude(command) * len(_omega(command))


def _omega(command: NoiseCommand) -> Array:
    first, last = math.ceil(command.lowest * command.period - 1e-9), math.floor(command.highest * command.period + 1e-9)
    return np.asarray(2 * np.pi * np.arange(max(first, 1), last + 1) / command.period, dtype=np.float64)


def _amplitude(command: NoiseCommand) -> float:
    return command.effort * math.sqrt(2 / max(len(_omega(command)), 1))


def commanded_motion(joints: Sequence[str], commands: Sequence[SweepCommand], pose: Sequence[float]) -> JointMotion:
    """From standstill at `pose` (n,) to standstill, (m, n); joints without a command stand."""
    # 40 samples a period of the highest line: its acceleration is 0.4 % low
    duration, rate = commands[0].duration, max([50.0, *(40 * sine.frequency for one in commands for sine in one.sines)])
    time = np.linspace(0.0, duration, max(2, round(duration * rate) + 1))
    position = np.tile(np.asarray(pose, dtype=float), (len(time), 1))
    velocity = np.zeros_like(position)
    for command in commands:
        index = joints.index(command.joint)
        position[:, index] += path_of(command, time)
        velocity[:, index] = velocity_setpoint(_excitation(command), time)
    return JointMotion(position, velocity, np.asarray(np.gradient(velocity, time, axis=0), dtype=float))


def path_of(command: SweepCommand, time: Array) -> Array:
    """Position relative to the start at `time` (m,), s since the start; rad (m)."""
    return way(_excitation(command), time)


def _excitation(command: SweepCommand) -> Excitation:
    sines = tuple(Sine(frequency=sine.frequency, amplitude=sine.amplitude, phase=sine.phase) for sine in command.sines)
    return Excitation(command.offset_velocity, sines, command.period, command.periods, command.ramp, command.settle)


def _at_most(joint: str, quantity: str, value: float, limit: float, unit: str) -> None:
    if not value <= limit:
        shown, most = distinct(value, limit, digits=4)
        text = f"{quantity} {shown} {unit} is above the limit {most} {unit}"
        raise EnvelopeViolation(joint, text, measured=Measured(value, limit, unit))


def _within(joint: str, quantity: str, value: float, limits: tuple[float, float], unit: str) -> None:
    if not limits[0] <= value <= limits[1]:
        shown, low, high = distinct(value, *limits)
        text = f"{quantity} {shown} {unit} is outside {low} to {high} {unit}"
        beyond = limits[0] if value < limits[0] else limits[1]
        raise EnvelopeViolation(joint, text, measured=Measured(value, beyond, unit))


def _all_within(joint: str, quantity: str, values: Array, low: float, high: float, unit: str) -> None:
    bad = ~((values >= low) & (values <= high))  # catches NaN
    if bad.any():
        _within(joint, quantity, float(values[bad][0]), (low, high), unit)


def _shown(pose: Sequence[float]) -> str:
    return "[" + ", ".join(f"{position:.3f}" for position in pose) + "]"
