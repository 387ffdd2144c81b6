"""The records of one axis for the checks: the measured window of each sweep."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from service.identification.model import inertia_rows
from service.identification.motion.trajectory_record import runs_at_once
from service.model import Array, Axis, Robot, Sweep, SweepSpec

Channel = Literal["effort", "velocity", "position"]

CHANNELS: tuple[Channel, ...] = ("effort", "velocity", "position")


@dataclass(frozen=True)
class Record:
    """One sweep; `effort`, `velocity`, `position` (n,) are those of its measured window, SI on the joint side."""

    sweep: Sweep
    part: slice

    @classmethod
    def of(cls, sweep: Sweep) -> "Record":
        """The window, cut at the end of the record."""
        spec, time = sweep.spec, sweep.recording.time
        first = int(np.searchsorted(time, spec.measure_from - 0.5 / spec.sample_rate))
        last = len(time)
        if spec.period is not None and spec.periods is not None:
            last = min(last, first + round(min(spec.period * spec.periods * spec.sample_rate, 1e9)))
        return cls(sweep, slice(first, last))

    @property
    def spec(self) -> SweepSpec:
        return self.sweep.spec

    @property
    def id(self) -> str:
        return self.spec.id

    @property
    def rate(self) -> float:
        return self.spec.sample_rate

    @property
    def count(self) -> int:
        """Samples of the window."""
        return max(self.part.stop - self.part.start, 0)

    @cached_property
    def effort(self) -> Array:
        return self.sweep.recording.effort[self.part]

    @cached_property
    def velocity(self) -> Array:
        return self.sweep.recording.velocity[self.part]

    @cached_property
    def position(self) -> Array:
        return self.sweep.recording.position[self.part]

    @cached_property
    def steps(self) -> dict[str, float]:
        """`resolution` of effort, velocity and position."""
        return {name: resolution(getattr(self, name)) for name in CHANNELS}

    @property
    def load_position(self) -> Array | None:
        load = self.sweep.recording.load_position
        return None if load is None else load[self.part]

    @property
    def turns(self) -> bool:
        """Whether the axis moves in one direction only, as commanded."""
        return self.spec.offset_velocity != 0 and self.spec.excitation in ("multisine", "noise")

    @property
    def travels(self) -> bool:
        """Whether the axis travels: in one direction, or along a trajectory."""
        return self.turns or self.spec.excitation == "trajectory"

    @property
    def alone(self) -> bool:
        """Whether no other axis moved at the same time."""
        return not runs_at_once(self.spec)

    @property
    def peak(self) -> float:
        """The largest commanded speed, rad/s (m/s); 0 for trajectories."""
        return abs(self.spec.offset_velocity) + sum(sine.amplitude for sine in self.spec.sines)


@dataclass(frozen=True)
class AxisRecords:
    """All records of one axis that are long enough for the checks."""

    robot: Robot
    index: int
    records: tuple[Record, ...]

    @classmethod
    def of(cls, robot: Robot, joint: str, sweeps: Sequence[Sweep]) -> "AxisRecords":
        records = [Record.of(sweep) for sweep in sweeps if sweep.spec.axis == joint]
        # 32 samples of a window: with fewer, no check is possible
        return cls(robot, robot.index(joint), tuple(record for record in records if record.count >= 32))

    def without(self, ids: Collection[str]) -> "AxisRecords":
        """The same without these sweeps."""
        return replace(self, records=self.those(lambda record: record.id not in ids)) if ids else self

    @property
    def axis(self) -> Axis:
        return self.robot.axes[self.index]

    @property
    def joint(self) -> str:
        return self.axis.joint

    @property
    def prismatic(self) -> bool:
        return self.robot.chain.joints[self.index].kind == "prismatic"

    @property
    def unit(self) -> str:
        """Unit of effort."""
        return "N" if self.prismatic else "N m"

    @cached_property
    def fastest(self) -> float:
        """The largest commanded speed of all records, rad/s (m/s); 0 for trajectories."""
        return max((record.peak for record in self.records), default=0.0)

    def those(self, chosen: Callable[[Record], bool]) -> tuple[Record, ...]:
        return tuple(record for record in self.records if chosen(record))

    def channels(
        self, names: Sequence[Channel] = CHANNELS, chosen: Callable[[Record], bool] = lambda _: True
    ) -> Iterator[tuple[Channel, list[tuple[Record, Array]]]]:
        """For each channel, its samples in the records that are `chosen`."""
        for name in names:
            yield name, [(record, getattr(record, name)) for record in self.those(chosen)]

    def load_inertia(self, pose: Sequence[float], index: int | None = None) -> float:
        """Inertia of the links that an axis moves, kg m^2 (kg), from CAD, in a pose; `index`: another axis."""
        links = self.robot.chain.inertial.ravel()
        return float(inertia_rows(self.robot.chain, self.index if index is None else index, np.array(pose))[0] @ links)

    def nominal_inertias(self, poses: Array, index: int | None = None) -> Array:
        """The same including the motor, for poses (m, joints): (m,)."""
        index = self.index if index is None else index
        rows = inertia_rows(self.robot.chain, index, poses)
        return rows @ self.robot.chain.inertial.ravel() + (self.robot.axes[index].reflected_motor_inertia or 0.0)


def spread(values: Array) -> float:
    """Robust standard deviation; for a normal distribution equal to the standard deviation."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values)))) if values.size else 0.0


def resolution(values: Array) -> float:
    """The step (smallest difference between two values that occur) of a channel; 0 if the channel is not quantised.

    The differences of a quantised channel are integer multiples of the smallest, within the precision of 32-bit floats.
    """
    levels = np.unique(values)
    if levels.size < 2:
        return 0.0
    gaps = np.diff(levels)
    rounding = 4 * float(np.finfo(np.float32).eps) * float(np.abs(levels).max())
    gaps = gaps[gaps > rounding]
    if not gaps.size:
        return 0.0
    step = float(gaps.min())
    near = gaps[gaps < 1.5 * step]
    step = float(np.median(near))
    off = np.abs(gaps / step - np.round(gaps / step))
    regular = float(np.mean(off <= 0.05 + rounding / step)) > 0.98
    return step if regular and near.size >= min(3, gaps.size) else 0.0
