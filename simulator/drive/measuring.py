"""The measuring function: sweep parameters in, speed set-points out, a trace of every sample kept.

Set-point ``e(t) (offset + sum a_i sin(2 pi f_i (t - t0) + phi_i))``, t0 = ramp + settle, with the envelope
``e = (1 - cos(pi t / ramp)) / 2`` while rising, one, and mirrored while falling. Motor side: parameters and trace in
rev, rev/min and N m as the dictionary has them; what goes to and comes from the axis is in rev/s.
"""

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from simulator.drive.dictionary import Abort, AbortCode, Dictionary

Array = NDArray[np.float64]

_RECORD = np.dtype(
    [("cycle", "<u4"), ("torque", "<f4"), ("command", "<f4"), ("speed", "<f4"), ("position", "<f8"), ("load", "<f8")]
)
_LONGEST = 600.0  # s
_HIGHEST = 500.0  # Hz


class Run(IntEnum):
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


@dataclass(frozen=True, slots=True)
class Samples:
    """What one axis did in m drive cycles, motor side; each (m,)."""

    torque: Array  # N m
    torque_limited: NDArray[np.bool_]
    command: Array  # rev/s
    speed: Array  # rev/s
    position: Array  # rev
    load: Array  # revolutions of the joint, NaN without direct encoder


@dataclass(frozen=True, slots=True)
class Sweep:
    """Parameters as in 2100h to 2103h; `sines` are (Hz, rev/min, rad)."""

    offset: float
    ramp: float
    settle: float
    period: float
    periods: int
    sines: tuple[tuple[float, float, float], ...]

    @property
    def duration(self) -> float:
        """From standstill to standstill, s."""
        return 2 * self.ramp + self.settle + self.period * self.periods

    @property
    def peak(self) -> float:
        """An upper bound of the speed, rev/min."""
        return abs(self.offset) + sum(abs(amplitude) for _, amplitude, _ in self.sines)

    def valid(self) -> bool:
        """Whether every number is finite, times are positive and neither length nor frequencies are absurd."""
        numbers = [self.offset, self.ramp, self.settle, self.period, *(n for sine in self.sines for n in sine)]
        return (
            all(math.isfinite(number) for number in numbers)
            and self.ramp > 0
            and self.settle >= 0
            and self.period > 0
            and self.duration <= _LONGEST
            and all(0 < frequency <= _HIGHEST for frequency, _, _ in self.sines)
        )

    def setpoints(self, cycle: float) -> Array:
        """Speed at the end of every drive cycle (m,), rev/s."""
        time = np.arange(1, round(self.duration / cycle) + 1) * cycle
        edge = np.clip(np.minimum(time, self.duration - time) / self.ramp, 0.0, 1.0)
        speed = np.full_like(time, self.offset / 60)
        for frequency, amplitude, phase in self.sines:
            speed += amplitude / 60 * np.sin(2 * np.pi * frequency * (time - self.ramp - self.settle) + phase)
        return (1 - np.cos(np.pi * edge)) / 2 * speed


class Trace:
    """Block means over `stride` drive cycles, at most `capacity` samples."""

    def __init__(self, stride: int, capacity: int, cycle: float) -> None:
        self.period = stride * cycle  # of a sample, s
        self._stride = stride
        self._records = np.zeros(capacity, _RECORD)
        self._rest = np.empty((5, 0))
        self.count = 0

    def extend(self, samples: Samples) -> None:
        """Take the samples of some drive cycles."""
        columns = (samples.torque, 60 * samples.command, 60 * samples.speed, samples.position, samples.load)
        rows = np.hstack((self._rest, np.vstack(columns)))
        blocks = min(rows.shape[1] // self._stride, len(self._records) - self.count)
        used = blocks * self._stride
        means = rows[:, :used].reshape(5, blocks, self._stride).mean(axis=2)
        page = self._records[self.count : self.count + blocks]
        page["cycle"] = np.arange(self.count, self.count + blocks)
        for field, values in zip(("torque", "command", "speed", "position", "load"), means, strict=True):
            page[field] = values
        self._rest = rows[:, used:]
        self.count += blocks

    def falsify(self, sample: int, revolutions: float) -> None:
        """The motor encoder was off by `revolutions` during a sample that is recorded already."""
        record = self._records[sample]
        record["position"] += revolutions
        record["speed"] += 60 * revolutions / self.period

    def page(self, first: int, number: int) -> bytes:
        """The bytes of at most `number` samples from `first`; what is not recorded yet is left out."""
        return self._records[first : min(first + number, self.count)].tobytes()


class MeasuringFunction:
    """The function behind 2100h to 2110h: gives the axis set-points while it runs; the axis brakes after `stop`."""

    def __init__(self, dictionary: Dictionary, cycle: float) -> None:
        self._dictionary = dictionary
        self._cycle = cycle
        self._setpoints: Array = np.empty(0)
        self._next = 0
        self._trace = Trace(1, 0, cycle)
        dictionary.on_upload((0x2110, 3), self._page)

    @property
    def run(self) -> Run:
        """State, 2100h:02."""
        return Run(self._dictionary[0x2100, 2])

    @property
    def driving(self) -> bool:
        """Whether the set-points come from here (running, and not being aborted)."""
        return self._next < len(self._setpoints)

    @property
    def count(self) -> int:
        """Samples recorded so far."""
        return self._trace.count

    def reset(self) -> None:
        """Forget everything, as at power-on."""
        self._setpoints, self._next, self._trace = np.empty(0), 0, Trace(1, 0, self._cycle)

    def start(self, position: float, *, ready: bool, limit: float, window: tuple[float, float]) -> None:
        """Check the parameters and start from `position`, rev, or say why not; `limit` rev/s, `window` rev."""
        sweep = self._sweep()
        reason = Rejection.NONE
        if not ready:
            reason = Rejection.NOT_ENABLED
        elif not sweep.valid():
            reason = Rejection.PARAMETERS
        elif sweep.peak > 60 * limit:
            reason = Rejection.SPEED
        else:
            setpoints = sweep.setpoints(self._cycle)
            path = position + np.cumsum(setpoints) * self._cycle
            if path.min() < window[0] or path.max() > window[1]:
                reason = Rejection.POSITION_WINDOW
            else:
                self._begin(setpoints)
        self._dictionary[0x2100, 2] = Run.RUNNING if reason is Rejection.NONE else Run.REJECTED
        self._dictionary[0x2100, 3] = reason

    def setpoints(self, cycles: int) -> Array:
        """The next set-points (cycles,), rev/s; zeros after the end."""
        part = self._setpoints[self._next : self._next + cycles]
        self._next += cycles
        return np.concatenate((part, np.zeros(cycles - len(part))))

    def record(self, samples: Samples) -> None:
        """Keep what the axis did, and be done after the last set-point."""
        if not self._dictionary.traits.load_encoder:
            samples = replace(samples, load=np.full_like(samples.load, np.nan))
        self._trace.extend(samples)
        self._dictionary[0x2100, 0x0B] = self._trace.count
        if not self.driving:
            self._dictionary[0x2100, 2] = Run.DONE

    def falsify(self, sample: int, revolutions: float) -> None:
        """Put the motor encoder of a sample off that is recorded already."""
        self._trace.falsify(sample, revolutions)

    def stop(self) -> None:
        """No more set-points, no more samples; `aborted` follows when the axis stands."""
        self._setpoints = np.empty(0)

    def aborted(self) -> None:
        """The axis stands after a stop."""
        if self.run is Run.RUNNING:
            self._dictionary[0x2100, 2] = Run.ABORTED

    def _begin(self, setpoints: Array) -> None:
        stride = round(self._dictionary[0x2100, 0x0A] * 1e-3 / self._cycle)
        self._setpoints, self._next = setpoints, 0
        self._trace = Trace(stride, len(setpoints) // stride, self._cycle)
        self._dictionary[0x2100, 0x0B] = 0

    def _sweep(self) -> Sweep:
        d = self._dictionary
        sines = tuple((d[0x2101, k], d[0x2102, k], d[0x2103, k]) for k in range(1, d[0x2100, 9] + 1))
        return Sweep(d[0x2100, 4], d[0x2100, 5], d[0x2100, 6], d[0x2100, 7], d[0x2100, 8], sines)

    def _page(self) -> bytes:
        page = self._trace.page(self._dictionary[0x2110, 1], self._dictionary[0x2110, 2])
        if not page:
            raise Abort(AbortCode.NO_DATA)
        return page
