"""The plant under cascade control: drive trains, PI speed controllers, and the steps within each 1 ms cycle.

A cycle has `SUBSTEPS` steps of control and mechanics. Set-point and injected torque are linear from the last cycle's
value to the new one (the drive's fine interpolator; a staircase would alias into the torque). Every channel of a sample
is the mean over the same instants of the cycle, so any linear relation between torque and motion also holds between the
samples, unless the scenario has delay, smoothing or errors of effort or motor speed.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Generic, Protocol

import numpy as np
from numpy.typing import NDArray

from simulator.drive_train import ARRAYS, FLOATS, Arithmetic, Array, DriveTrains, Masses, Value
from simulator.rigid_body import MovingAxis
from simulator.scenario import CYCLE, STEP, Measurement, SpeedControl

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
