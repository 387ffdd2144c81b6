"""Modes of operation of a foreign drive: from targets in the dictionary to speed set-points (CiA 402-2).

Positions in rev, speeds in rev/s of the motor. The modes of a drive are the bits of its 6502h.
"""

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from simulator.drive.profile import Motion, brake, travel
from simulator.foreign.dictionary import ForeignDictionary
from simulator.foreign.units import Units

Array = NDArray[np.float64]

_POSITION_GAIN = 10.0  # 1/s, position controller


class Mode(IntEnum):
    """Values of 6060h that move an axis here. Other modes of a drive are refused like unsupported ones."""

    NONE = 0
    PROFILE_POSITION = 1
    PROFILE_VELOCITY = 3
    INTERPOLATED_POSITION = 7
    CYCLIC_POSITION = 8
    CYCLIC_VELOCITY = 9


CYCLIC = (Mode.INTERPOLATED_POSITION, Mode.CYCLIC_POSITION, Mode.CYCLIC_VELOCITY)
SET_POINTS = ((0x607A, 0), (0x60B0, 0), (0x60B1, 0), (0x60B2, 0), (0x60C1, 1), (0x60FF, 0))
"""Modes in which a host sends set-points with SYNC."""
_TRACKING = (Mode.PROFILE_POSITION, Mode.INTERPOLATED_POSITION, Mode.CYCLIC_POSITION)


def supported(modes: int, value: int) -> bool:
    """Whether 6502h `modes` includes the mode of 6060h `value`, and it moves an axis here; 0 is always included."""
    return value == 0 or (value in tuple(Mode) and bool(modes >> (value - 1) & 1))


class Guide:
    """Set-points of one energised axis. `command` is the last speed, `reference` the position."""

    def __init__(self, dictionary: ForeignDictionary, units: Units, cycle: float) -> None:
        self._dictionary = dictionary
        self._units = units
        self._cycle = cycle
        self.command = self.reference = 0.0
        self.start(Mode.NONE, 0.0)

    def start(self, mode: Mode, position: float) -> None:
        """Begin a mode from standstill at `position`. Targets keep the values written by the host."""
        self.mode = mode
        self.running = True  # interpolated position starts with bit 4 of the controlword
        self.halted = False
        self.limited = False  # a target was limited
        self.stopped = False  # braked by a command: targets are ignored until `resume` or `start`
        self.hold(position)

    def hold(self, position: float) -> None:
        """Stand at `position` until a target commands a motion."""
        self.reference, self.command = position, 0.0
        self._motion: Motion | None = None
        self.ramping = False
        self._time = 0.0  # since the start of the motion
        self._origin = position  # of the motion
        self._target: float | None = None  # of the last move or interpolation
        self._left = 0  # remaining cycles of the interpolation

    # Commands

    def move(self, position: float, target: float, *, relative: bool) -> None:
        """Start a profile position move."""
        if relative:
            target += self.reference if self._target is None else self._target
        low, high = self._units.window
        self._target = min(max(target, low), high)
        self.limited = self._target != target
        self._origin = position if self.ramping else self.reference
        limit = min(self._units.profile_limit, self._dictionary.get(0x6081) / abs(self._units.velocity))
        if limit > 0.0:
            up, down = self._units.ramp(0x6083), self._units.ramp(0x6084)
            self._motion = travel(self._target - self._origin, self.command, limit, up, down)
            self._time, self.ramping, self.stopped = 0.0, False, False

    def ramp_down(self, deceleration: float) -> None:
        """Brake to standstill with `deceleration`, rev/s^2, in any mode."""
        self._motion, self._time, self.ramping = brake(self.command, deceleration), 0.0, True
        self.stopped = True

    def resume(self) -> None:
        """Accept targets again after a halt."""
        self.stopped = False

    # State

    @property
    def moving(self) -> bool:
        """Whether set-points differ from zero, or may do so in the next cycle."""
        return self._motion is not None or self.command != 0.0 or self._left > 0

    @property
    def ended(self) -> float | None:
        """Seconds since a ramp to standstill ended; None while it runs, or if there is none."""
        if self._motion is None or not self.ramping or self._time < self._motion.duration:
            return None
        return self._time - self._motion.duration

    @property
    def tracking(self) -> bool:
        """Whether the position is controlled."""
        return self.mode in _TRACKING and not self.ramping

    @property
    def target(self) -> float | None:
        """Target of the last profile position move, rev."""
        return self._target

    # Cycles

    def setpoints(self, cycles: int, position: float) -> Array:
        """Speeds at the end of each of the next cycles (cycles,), with the axis at `position` now."""
        limit = self._units.speed_limit
        if self._motion is not None:
            speeds = self._along(self._motion, cycles)
        elif self.stopped:
            self.command, speeds = 0.0, np.zeros(cycles)
        elif self.mode is Mode.CYCLIC_VELOCITY:
            speeds = self._interpolate_velocity(cycles)
        elif self.mode is Mode.PROFILE_VELOCITY:
            speeds = self._ramp_velocity(cycles)
        elif self.mode in CYCLIC and self.running:
            speeds = self._interpolate_position(cycles)
        else:
            self.command, speeds = 0.0, np.zeros(cycles)
        if self.tracking:
            speeds = speeds + _POSITION_GAIN * (self.reference - position)
        return np.clip(speeds, -limit, limit)

    def finish(self) -> None:
        """End a move that has reached its end."""
        if self._motion is not None and not self.ramping and self._time >= self._motion.duration:
            self._motion = None

    def _along(self, motion: Motion, cycles: int) -> Array:
        times = self._time + np.arange(1, cycles + 1, dtype=np.float64) * self._cycle
        speeds = motion.velocity(times)
        self._time, self.command = float(times[-1]), float(speeds[-1])
        self.reference = self._origin + float(motion.position(times[-1:])[0])
        return speeds

    def _interpolate_velocity(self, cycles: int) -> Array:
        goal = self._velocity_goal(self._units.speed_limit)
        if goal != self._target:
            self._target, self._left = goal, self.period
        speeds = np.empty(cycles)
        for k in range(cycles):
            if self._left > 0:
                self.command += (goal - self.command) / self._left
                self._left -= 1
            speeds[k] = self.command
        return speeds

    def _ramp_velocity(self, cycles: int) -> Array:
        goal = 0.0 if self.halted else self._velocity_goal(self._units.profile_limit)
        speeds = np.empty(cycles)
        for k in range(cycles):
            slower = abs(goal) < abs(self.command) or goal * self.command < 0
            step = self._units.ramp(0x6084 if slower else 0x6083) * self._cycle
            self.command += min(max(goal - self.command, -step), step)
            speeds[k] = self.command
        return speeds

    def _interpolate_position(self, cycles: int) -> Array:
        d, cyclic = self._dictionary, self.mode is Mode.CYCLIC_POSITION
        key = (0x607A, 0) if cyclic else (0x60C1, 1)
        asked = (d[key] + (d.get(0x60B0) if cyclic else 0)) / self._units.position
        low, high = self._units.window
        goal = min(max(asked, low), high)
        self.limited = goal != asked
        if goal != self._target:
            self._target, self._left = goal, self.period
        ahead = d.get(0x60B1) / self._units.velocity if cyclic else 0.0
        speeds = np.empty(cycles)
        for k in range(cycles):
            way = (goal - self.reference) / self._left if self._left > 0 else 0.0
            self._left = max(self._left - 1, 0)
            self.reference += way
            speeds[k] = way / self._cycle + ahead
        limit = self._units.speed_limit
        self.command = min(max(float(speeds[-1]), -limit), limit)
        return speeds

    def _velocity_goal(self, limit: float) -> float:
        d = self._dictionary
        offset = d.get(0x60B1) if self.mode is Mode.CYCLIC_VELOCITY else 0
        asked = (d[0x60FF, 0] + offset) / self._units.velocity
        goal = min(max(asked, -limit), limit)
        self.limited = goal != asked
        return goal

    @property
    def period(self) -> int:
        """60C2h in cycles, at least 1: time in which a new set-point is reached."""
        d = self._dictionary
        return max(round(d.get(0x60C2, 1) * 10.0 ** d.get(0x60C2, 2, -3) / self._cycle), 1)
