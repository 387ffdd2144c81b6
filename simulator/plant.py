"""The plant under cascade control: drive trains, PI speed controllers, and the steps within each 1 ms cycle.

A cycle has `SUBSTEPS` steps of control and mechanics. Set-point and injected torque are linear from the last cycle's
value to the new one (the drive's fine interpolator; a staircase would alias into the torque). Every channel of a sample
is the mean over the same instants of the cycle, so any linear relation between torque and motion also holds between the
samples, unless the scenario has delay, smoothing or errors of effort or motor speed.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from simulator.channel import Channel
from simulator.drive_train import DriveTrains
from simulator.moving_axis import MovingAxis
from simulator.scenario import CYCLE, STEP, Measurement, SpeedControl
from simulator.speed_loop import SpeedLoop
from simulator.train_step import ARRAYS, Masses, Value

Array = NDArray[np.float64]

SUBSTEPS = round(CYCLE / STEP)
_CHUNK = 256  # cycles whose steps are stored before they are averaged


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
        parts = [
            self._chunk(setpoints[k : k + _CHUNK], None if injected is None else injected[k : k + _CHUNK])
            for k in range(0, len(setpoints), _CHUNK)
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
