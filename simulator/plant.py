"""The plant under cascade control: drive trains, PI speed controllers, and the steps within each 1 ms cycle.

A cycle has `SUBSTEPS` steps of control and mechanics. Set-point and injected torque are linear from the last cycle's
value to the new one (the drive's fine interpolator; a staircase would alias into the torque). Every channel of a sample
is the mean over the same instants of the cycle, so any linear relation between torque and motion also holds between the
samples, unless the scenario has delay, smoothing or errors of effort or motor speed.

Drive trains that share one robot: every link feels the others (inertia, Coriolis and centrifugal force, gravity).

    Jm vm' = u - Ts - fm(vm) - cogging(qm)          M(ql) vl' = Ts - fl(vl) - h(ql, vl),      h from MuJoCo

Leapfrog as in `drive_train`, with all friction and damping trapezoidal in one linear system for the new velocities:

    (I + D step/2) v+ = (I - D step/2) v- + step force,     I = diag(Jm, M),   D = viscous and structural damping

Coulomb friction: impulses p within +- step Fc that bring v+ to rest where they can, v <- v - K p with the inverse K of
I + D step/2. They are found by projected Jacobi iteration from the last step's, so an axis that slips has its exact
friction at once and one that sticks rests to the iteration's tolerance. While no more than one brake is open, the rows
do not touch each other and the step is that of the single axes.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Generic, Protocol

import numpy as np
from numpy.typing import NDArray

from simulator.drive_train import ARRAYS, FLOATS, Arithmetic, DriveTrains, Masses, TrainAlone, Value
from simulator.rigid_body import MovingAxis, RigidBody, moving_axis
from simulator.scenario import CYCLE, STEP, Measurement, Scenario, SpeedControl
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
        return inertia, bias + self.spring_load() if self._is_pulled else bias

    def holding_torque(self) -> Array:
        """As for single axes, with gravity in the present pose of all joints."""
        return self._dynamics(np.zeros(len(self._driven)))[1]

    @property
    def axes(self) -> Sequence[MovingAxis]:
        """The driven axes in the present pose, each as a single axis."""
        pose = self._standing.tolist()
        return [moving_axis(self._scenario, self._body, joint, pose) for joint in self.joints]


SUBSTEPS = round(CYCLE / STEP)


@dataclass(frozen=True, slots=True)
class Samples:
    """One value per cycle, arrays (cycles, rows), joint side: N m, rad/s, rad."""

    effort: Array
    velocity: Array
    position: Array
    load_position: Array
    load_velocity: Array
    velocity_setpoint: Array
    excitation_effort: Array  # the injected part of the torque
    torque_limited: NDArray[np.bool_]


class Channel:
    """A measured channel at the output of the drive: a `delay`, then first-order `smoothing` (T), both in s.

    A delay between two steps is interpolated linearly: error at most 8e-4 of a line at 50 Hz. Smoothing obeys
    ``T y' = u - y`` and is exact for a signal u that is linear between its steps h: with a = exp(-h/T) and
    g = (1 - a) T/h, y[n] = a y[n-1] + (1 - g) u[n] + (g - a) u[n-1]. The response of the channel to a line well below
    1/h is therefore exp(-iw delay) / (1 + iwT), without a discretisation delay.
    """

    def __init__(self, rows: int, step: float, delay: float, smoothing: float) -> None:
        whole = math.floor(delay / step + 1e-9)
        part = delay / step - whole
        self._part = part if part > 1e-9 else 0.0  # fraction of a step, added to the whole ones
        self._late = np.zeros((whole + bool(self._part), rows))
        self._smoothing = smoothing
        if smoothing:
            self._keep = math.exp(-step / smoothing)
            gain = (1 - self._keep) * smoothing / step
            self._now, self._before = 1 - gain, gain - self._keep
            self._state = np.zeros((1, rows))

    def restart(self, row: int, value: float) -> None:
        """The signal of the row was constant at `value`."""
        self._late[:, row] = value
        if self._smoothing:
            self._state[:, row] = (1 - self._now) * value

    def pass_on(self, signal: Array) -> Array:
        """Output for the input `signal` (steps, rows); the same shape."""
        if len(self._late):
            delayed = np.concatenate([self._late, signal])
            self._late = delayed[len(signal) :]
            older = delayed[: len(signal)]
            signal = older + (1 - self._part) * (delayed[1 : len(signal) + 1] - older) if self._part else older
        if self._smoothing:
            from scipy.signal import lfilter  # imported here, as it takes half a second and is rarely needed

            signal, self._state = lfilter([self._now, self._before], [1.0, -self._keep], signal, axis=0, zi=self._state)
        return signal


@dataclass(slots=True)
class SpeedLoop(Generic[Value]):
    """The PI speed controller, for rows of arrays or for one row in floats; N m, rad/s of the joint."""

    gain: Value  # N m s/rad
    reset: Value  # N m s/rad per step
    limit: Value
    integral: Value
    arithmetic: Arithmetic[Value]

    def alone(self: "SpeedLoop[Array]", row: int) -> "SpeedLoop[float]":
        """The controller of one row, in floats."""
        gain, reset, limit, integral = (float(part[row]) for part in (self.gain, self.reset, self.limit, self.integral))
        return SpeedLoop(gain, reset, limit, integral, FLOATS)

    def effort(self, setpoint: Value, velocity: Value, injected: Value) -> Value:
        """PI and injected torque within the limit; anti-windup by back-calculation at the limit."""
        error = setpoint - velocity
        integral = self.integral + self.reset * error
        wanted = self.gain * error + integral + injected
        effort = self.arithmetic.within(wanted, -self.limit, self.limit)
        self.integral = integral + effort - wanted
        return effort


def measure(
    samples: Samples, measurement: Measurement, rated_effort: Array, random: Sequence[np.random.Generator]
) -> Samples:
    """Samples as reported by the drive; `rated_effort` (rows,) N m, one random stream per row."""

    def noisy(values: Array, rms: float | Array) -> Array:
        if not np.any(rms):
            return values
        noise = np.empty_like(values)
        for row, stream in enumerate(random):
            noise[:, row] = stream.standard_normal(len(values))
        return values + rms * noise

    effort = noisy(samples.effort, measurement.effort_noise * rated_effort)
    if measurement.effort_resolution:
        step = measurement.effort_resolution * rated_effort
        effort = np.round(effort / step) * step
    return replace(
        samples,
        effort=effort,
        velocity=noisy(samples.velocity, measurement.velocity_noise),
        position=noisy(samples.position, measurement.position_noise),
        load_position=noisy(samples.load_position, measurement.load_position_noise),
        load_velocity=noisy(samples.load_velocity, measurement.load_velocity_noise),
    )


class Plant:
    """Many axes in closed loop, one row each."""

    def __init__(self, axes: Sequence[MovingAxis], controls: Sequence[SpeedControl], measurement: Measurement) -> None:
        rows = len(axes)
        self.trains = DriveTrains(axes, STEP)
        limit = np.array([c.effort_limit for c in controls])
        self.loop = SpeedLoop(np.zeros(rows), np.zeros(rows), limit, np.zeros(rows), ARRAYS)
        for row, control in enumerate(controls):
            self.tune(row, control.gain, control.reset_time)
        self._setpoint = np.zeros(rows)
        self._injected = np.zeros(rows)
        self._recorded_gain = np.array([axis.train.effort_gain for axis in axes])
        self._recorded_offset = np.array([axis.train.effort_offset for axis in axes])
        self._effort = Channel(rows, STEP, measurement.effort_delay, measurement.effort_smoothing)
        self._velocity = Channel(rows, STEP, measurement.velocity_delay, measurement.velocity_smoothing)

    def tune(self, row: int, gain: float, reset_time: float) -> None:
        """Change the speed control of a row, N m s/rad and s; its present torque is kept."""
        self.loop.gain[row] = gain
        self.loop.reset[row] = gain * STEP / reset_time

    def release(self, row: int) -> None:
        """Open the brake of a standing row with the torque that balances gravity."""
        self.loop.integral[row] = holding = self.trains.settle(row)
        self._effort.restart(row, holding)
        self._velocity.restart(row, 0.0)
        self._setpoint[row] = self._injected[row] = 0.0
        self.trains.free[row] = 1.0

    def brake(self, row: int) -> None:
        """Close the brake of a row: it stands at once and its motor has no torque."""
        self.trains.free[row] = 0.0
        self.trains.velocity[:, row] = 0.0
        self._setpoint[row] = self._injected[row] = 0.0

    def advance(self, setpoints: Array, injected: Array | None = None) -> Samples:
        """Run ``len(setpoints)`` cycles; set-points (cycles, rows) rad/s are reached at the end of their cycles.

        The same applies to the `injected` torque, N m, which is added to that of the speed controller; default none.
        """
        most = 256  # cycles whose steps are stored before they are averaged
        parts = [
            self._chunk(setpoints[k : k + most], None if injected is None else injected[k : k + most])
            for k in range(0, len(setpoints), most)
        ]
        if not parts:
            raise ValueError("nothing to advance: no set-points")
        return Samples(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Samples)))

    def _chunk(self, setpoints: Array, torques: Array | None) -> Samples:
        cycles, rows = setpoints.shape
        steps = cycles * SUBSTEPS
        wanted = _straight(self._setpoint, setpoints)
        self._setpoint = setpoints[-1].copy()
        injected = np.zeros((steps, rows)) if torques is None else _straight(self._injected, torques)
        self._injected = injected[-1].copy()

        masses = len(self.trains.position)
        effort, position = np.zeros((steps, rows)), np.empty((steps, masses, rows))
        velocity = np.empty((steps + 1, masses, rows))
        velocity[0] = self.trains.velocity
        alone = self.trains.alone()
        if alone is None:
            _run(self.loop, self.trains, wanted, injected, effort, position, velocity[1:])
        else:
            position[:], velocity[1:] = self.trains.position, self.trains.velocity  # of rows with a closed brake
            for row, train in alone.items():
                loop, nothing = self.loop.alone(row), [None] * steps
                parts: tuple[list[Any], ...] = (nothing[:], nothing[:], nothing)
                _run(loop, train, wanted[:, row].tolist(), injected[:, row].tolist(), *parts)
                effort[:, row], position[:, :, row], velocity[1:, :, row] = parts
                self.loop.integral[row] = loop.integral
                self.trains.take_back(row, train)
        velocity = (velocity[1:] + velocity[:-1]) / 2
        limited = np.abs(effort) >= self.loop.limit
        return Samples(
            effort=_means(self._effort.pass_on(effort)) * self._recorded_gain + self._recorded_offset,
            velocity=_means(self._velocity.pass_on(velocity[:, 0])),
            position=_means(position[:, 0]),
            load_position=_means(position[:, -1]),
            load_velocity=_means(velocity[:, -1]),
            velocity_setpoint=_means(wanted),
            excitation_effort=_means(injected),
            torque_limited=limited.reshape(cycles, SUBSTEPS, rows).max(axis=1),
        )


class _Train(Protocol[Value]):
    """`DriveTrains`, or a single row of them."""

    @property
    def position(self) -> Masses[Value]: ...
    @property
    def velocity(self) -> Masses[Value]: ...
    @property
    def free(self) -> Value: ...
    def step(self, effort: Value) -> None: ...


def _run(
    loop: SpeedLoop[Value],
    train: _Train[Value],
    wanted: Iterable[Value],
    injected: Iterable[Value],
    effort: Any,
    position: Any,
    velocity: Any,
) -> None:
    """Steps to the set-points `wanted`. The last three arrays get torque and position before, and velocity after each
    step.
    """
    for n, (setpoint, torque) in enumerate(zip(wanted, injected, strict=True)):
        effort[n] = given = loop.effort(setpoint, train.velocity[0], torque) * train.free
        position[n] = train.position
        train.step(given)
        velocity[n] = train.velocity


def _straight(before: Array, values: Array) -> Array:
    """Steps (cycles * SUBSTEPS, rows) from the last cycle's value `before` (rows,) through `values` (cycles, rows)."""
    starts = np.concatenate([before[None], values[:-1]])
    part = np.arange(1, SUBSTEPS + 1)[:, None] / SUBSTEPS
    return (starts[:, None] + part * (values - starts)[:, None]).reshape(-1, values.shape[1])


def _means(steps: Array) -> Array:
    return steps.reshape(-1, SUBSTEPS, steps.shape[-1]).mean(axis=1)
