"""The measuring function: from its parameters to speed set-points and torque noise, with a trace of every sample.

The motion is that of `waveform`; injected torque ``e(t) n(t)``, where n has the given period from t = 0 on. Motor side:
parameters and trace in rev, rev/min and N m as in the dictionary; speeds to and from the axis in rev/s.
"""

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from simulator.drive.dictionary import AbortCode, ObjectDictionary, SdoAbort
from simulator.drive.limits import PER_MILLE, DriveLimits
from simulator.waveform import Array, Waveform, torque_noise


class ExcitationKind(IntEnum):
    """Kind of excitation, 2100h:0C."""

    MULTI_SINE = 0
    TORQUE_NOISE = 1


class FunctionState(IntEnum):
    """State of the function, 2100h:02."""

    IDLE = 0
    RUNNING = 1
    DONE = 2
    ABORTED = 3
    REJECTED = 4


class Rejection(IntEnum):
    """Why a start was refused, 2100h:03."""

    NONE = 0
    NOT_ENABLED = 1
    SPEED = 2
    POSITION_WINDOW = 3
    PARAMETERS = 4
    TORQUE = 5


@dataclass(frozen=True, slots=True)
class DriveSamples:
    """DriveSamples of one axis in m drive cycles, motor side; each (m,)."""

    torque: Array  # N m
    torque_limited: NDArray[np.bool_]
    command: Array  # rev/s
    speed: Array  # rev/s
    position: Array  # rev
    load: Array  # revolutions of the joint, NaN without direct encoder
    injected: Array  # N m, part of `torque`


class DriveTrace:
    """Block means over `stride` drive cycles, at most `capacity` samples; for torque noise with the injected torque."""

    def __init__(
        self, stride: int, capacity: int, cycle: float, kind: ExcitationKind = ExcitationKind.MULTI_SINE
    ) -> None:
        self.period = stride * cycle  # sample interval, s
        self._stride = stride
        kinds = {"torque": "<f4", "command": "<f4", "speed": "<f4", "position": "<f8", "load": "<f8"}
        kinds |= {"injected": "<f4"} if kind is ExcitationKind.TORQUE_NOISE else {}
        self._fields = tuple(kinds)
        self._records = np.zeros(capacity, np.dtype([("cycle", "<u4"), *kinds.items()]))
        self._rest = np.empty((len(self._fields), 0))
        self.count = 0

    def extend(self, samples: DriveSamples) -> None:
        """Add the samples of some drive cycles."""
        columns = (
            samples.torque,
            60 * samples.command,
            60 * samples.speed,
            samples.position,
            samples.load,
            samples.injected,
        )
        rows = np.hstack((self._rest, np.vstack(columns[: len(self._fields)])))
        blocks = min(rows.shape[1] // self._stride, len(self._records) - self.count)
        used = blocks * self._stride
        means = rows[:, :used].reshape(len(self._fields), blocks, self._stride).mean(axis=2)
        page = self._records[self.count : self.count + blocks]
        page["cycle"] = np.arange(self.count, self.count + blocks)
        for field, values in zip(self._fields, means, strict=True):
            page[field] = values
        self._rest = rows[:, used:]
        self.count += blocks

    def falsify(self, sample: int, revolutions: float) -> None:
        """The motor encoder was wrong by `revolutions` during a sample that is already recorded."""
        record = self._records[sample]
        record["position"] += revolutions
        record["speed"] += 60 * revolutions / self.period

    def page(self, first: int, number: int) -> bytes:
        """The bytes of at most `number` samples from `first`, as far as they are recorded."""
        return self._records[first : min(first + number, self.count)].tobytes()


class MeasuringFunction:
    """The function behind 2100h to 2110h. It provides set-points to the axis while it runs; the axis brakes after
    `stop`.
    """

    longest = 600.0
    """s; of a sweep."""
    highest = 500.0
    """Hz; of a line."""

    def __init__(self, dictionary: ObjectDictionary, limits: DriveLimits, cycle: float) -> None:
        self._dictionary = dictionary
        self._limits = limits
        self._cycle = cycle
        self.reset()
        dictionary.on_upload((0x2110, 3), self._page)

    @property
    def run(self) -> FunctionState:
        """State, 2100h:02."""
        return FunctionState(self._dictionary[0x2100, 2])

    @property
    def driving(self) -> bool:
        """Whether this function provides the set-points (running, and not being aborted)."""
        return self._next < len(self._setpoints)

    @property
    def injecting(self) -> bool:
        """Whether `injection` may differ from zero."""
        return self._next < len(self._injected)

    @property
    def count(self) -> int:
        return self.trace.count

    def reset(self) -> None:
        """Discard everything, as at power-on."""
        self._setpoints: Array = np.empty(0)
        self._injected: Array = np.empty(0)
        self._next = 0
        self.trace = DriveTrace(1, 0, self._cycle)

    def start(self, position: float, *, ready: bool) -> None:
        """Check the parameters and start from `position`, rev; otherwise set the reason of the rejection."""
        sweep, reason = self._sweep(), Rejection.NOT_ENABLED
        if ready:
            reason = Rejection.PARAMETERS if sweep is None else self._begin(sweep, position)
        self._dictionary[0x2100, 2] = FunctionState.RUNNING if reason is Rejection.NONE else FunctionState.REJECTED
        self._dictionary[0x2100, 3] = reason

    def injection(self, cycles: int) -> Array:
        """Torque to inject at the end of each of the next cycles (cycles,), N m; call before `setpoints`."""
        return _padded(self._injected[self._next : self._next + cycles], cycles)

    def setpoints(self, cycles: int) -> Array:
        """The next set-points (cycles,), rev/s; zeros after the end."""
        part = self._setpoints[self._next : self._next + cycles]
        self._next += cycles
        return _padded(part, cycles)

    def record(self, samples: DriveSamples) -> None:
        """Store samples; the state is DONE after the last set-point."""
        if not self._dictionary.load_encoder:
            samples = replace(samples, load=np.full_like(samples.load, np.nan))
        self.trace.extend(samples)
        self._dictionary[0x2100, 0x0B] = self.trace.count
        if not self.driving:
            self._dictionary[0x2100, 2] = FunctionState.DONE

    def stop(self) -> None:
        """No more set-points, torque and samples; call `aborted` when the axis stands."""
        self._setpoints = self._injected = np.empty(0)

    def aborted(self) -> None:
        """The axis stands after a stop."""
        if self.run is FunctionState.RUNNING:
            self._dictionary[0x2100, 2] = FunctionState.ABORTED

    def _begin(self, sweep: Waveform, position: float) -> Rejection:
        d, limits = self._dictionary, self._limits
        kind = ExcitationKind(d[0x2100, 0x0C])
        end_of_cycle = np.arange(1, round(sweep.duration / self._cycle) + 1, dtype=np.float64) * self._cycle
        setpoints, injected = sweep.velocity(end_of_cycle), np.empty(0)
        if kind is ExcitationKind.TORQUE_NOISE:
            rms, lowest, highest, seed = d[0x2104, 1], d[0x2104, 2], d[0x2104, 3], d[0x2104, 4]
            if not (math.isfinite(rms) and rms >= 0 and 0 <= lowest <= highest <= self.highest):
                return Rejection.PARAMETERS
            try:
                noise = torque_noise(rms, lowest, highest, sweep.period, seed, self._cycle)
            except ValueError:
                return Rejection.PARAMETERS
            injected = sweep.envelope(end_of_cycle) * np.resize(noise, len(end_of_cycle))
        if abs(d[0x2100, 4]) + sum(abs(amplitude) for _, amplitude, _ in self._sines) > 60 * limits.speed:
            return Rejection.SPEED
        path = position + np.cumsum(setpoints) * self._cycle
        low, high = limits.window
        if path.min() < low or path.max() > high:
            return Rejection.POSITION_WINDOW
        if np.abs(injected).max(initial=0.0) > limits.torque * d[0x6076, 0] / PER_MILLE:
            return Rejection.TORQUE
        stride = round(d[0x2100, 0x0A] * 1e-3 / self._cycle)
        self._setpoints, self._injected, self._next = setpoints, injected, 0
        self.trace = DriveTrace(stride, len(setpoints) // stride, self._cycle, kind)
        d[0x2100, 0x0B] = 0
        return Rejection.NONE

    @property
    def _sines(self) -> list[tuple[float, float, float]]:
        """(Hz, rev/min, rad); with noise, the set-point has only the offset."""
        d = self._dictionary
        number = d[0x2100, 9] if d[0x2100, 0x0C] == ExcitationKind.MULTI_SINE else 0
        return [(d[0x2101, k], d[0x2102, k], d[0x2103, k]) for k in range(1, number + 1)]

    def _sweep(self) -> Waveform | None:
        """In rev/s; None unless numbers are finite, times positive, duration and frequencies within their limits."""
        d, sines = self._dictionary, self._sines
        offset, ramp, settle, period, periods = (d[0x2100, sub] for sub in range(4, 9))
        numbers = [offset, ramp, settle, period, *(number for sine in sines for number in sine)]
        if not all(math.isfinite(number) for number in numbers):
            return None
        waves = tuple((frequency, amplitude / 60, phase) for frequency, amplitude, phase in sines)
        sweep = Waveform(offset / 60, waves, period, periods, ramp, settle)
        within = ramp > 0 and settle >= 0 and period > 0 and sweep.duration <= self.longest
        return sweep if within and all(0 < frequency <= self.highest for frequency, _, _ in sines) else None

    def _page(self) -> bytes:
        page = self.trace.page(self._dictionary[0x2110, 1], self._dictionary[0x2110, 2])
        if not page:
            raise SdoAbort(AbortCode.NO_DATA)
        return page


def _padded(part: Array, cycles: int) -> Array:
    return np.concatenate((part, np.zeros(cycles - len(part))))
