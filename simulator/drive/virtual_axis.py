"""The virtual drive: profile position, cyclic synchronous velocity and the measuring function over a dictionary.

Inputs: controlword and set-points (through the dictionary), orders, and the samples of the last cycles. Outputs:
`energised`, the next speed set-points, and values in the dictionary. Positions in rev, speeds in rev/s of the motor.
"""

import math

import numpy as np

from simulator.drive.dictionary import AbortCode, ObjectDictionary, SdoAbort
from simulator.drive.limits import INCREMENTS, PER_MILLE, DriveLimits
from simulator.drive.measuring import DriveSamples, FunctionState, MeasuringFunction
from simulator.drive.power_drive import DriveState, FaultCode, Mode, PowerDrive
from simulator.waveform import Array, RampProfile, brake, travel


class ControlParameters:
    """Gain and reset time of the speed controller (2140h), N m s/rad of the motor and s.

    The active values are in RAM and may be softened while the axis moves; the commissioned values are stored and
    read-only.
    """

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        dictionary.on_download((0x2140, 1), self._check_gain)
        dictionary.on_download((0x2140, 2), self._check_reset_time)

    @property
    def active(self) -> tuple[float, float]:
        return self._dictionary[0x2140, 1], self._dictionary[0x2140, 2]

    @property
    def softened(self) -> bool:
        """Whether the active values differ from the commissioned ones."""
        return self.active != (self._dictionary[0x2140, 3], self._dictionary[0x2140, 4])

    def restore(self) -> None:
        d = self._dictionary
        d[0x2140, 1], d[0x2140, 2] = d[0x2140, 3], d[0x2140, 4]

    def _check_gain(self, value: float) -> None:
        if not value > 0:
            raise SdoAbort(AbortCode.TOO_LOW)
        if value > self._dictionary[0x2140, 3]:
            raise SdoAbort(AbortCode.TOO_HIGH)

    def _check_reset_time(self, value: float) -> None:
        if not value >= self._dictionary[0x2140, 4]:
            raise SdoAbort(AbortCode.TOO_LOW)
        if value == math.inf:
            raise SdoAbort(AbortCode.TOO_HIGH)


class CyclicVelocity:
    """Cyclic synchronous velocity: the set-point 60FFh between two SYNCs in rev/s, and the monitoring of both
    (2121h).
    """

    def __init__(self, dictionary: ObjectDictionary, limits: DriveLimits) -> None:
        self._dictionary = dictionary
        self._limits = limits
        dictionary.on_download((0x60FF, 0), self._received)
        self.restart()

    def restart(self) -> None:
        """Start from standstill: no set-point and no SYNC received yet."""
        self.goal = 0.0
        self._dictionary[0x60FF, 0] = 0
        self._last_sync: float | None = None
        self._missing = 0
        self._fresh = False  # a set-point came since the last SYNC

    @property
    def period_agrees(self) -> bool:
        """Whether 60C2h and 1006h agree."""
        period = self._dictionary[0x60C2, 1] * 10.0 ** self._dictionary[0x60C2, 2]
        return math.isclose(period, self._dictionary[0x1006, 0] * 1e-6)

    @property
    def watch_until(self) -> float | None:
        """Time at which SYNC counts as missing, s; None before the first SYNC."""
        return None if self._last_sync is None else self._last_sync + self._dictionary[0x2121, 1] * 1e-3

    def sync(self, now: float) -> FaultCode | None:
        """Use the set-point received before this SYNC as target. Returns the fault if it is missing or not allowed."""
        self._last_sync = now
        self._missing = 0 if self._fresh else self._missing + 1
        self._fresh = False
        goal = self._dictionary[0x60FF, 0] / self._limits.speed_unit
        if self._missing > self._dictionary[0x2121, 2]:
            return FaultCode.SET_POINT_MISSING
        if abs(goal) > self._limits.speed:
            return FaultCode.SPEED_LIMIT
        self.goal = goal
        return None

    def _received(self, _: int) -> None:
        self._fresh = True


class Supervision:
    """Checks the samples of an enabled axis: position limits, speed, following error, time at the torque limit."""

    def __init__(self, limits: DriveLimits, cycle: float) -> None:
        self._limits = limits
        self._cycle = cycle
        self._speeds: list[float] = []
        self._limited = 0.0
        self._lagging = 0.0

    @property
    def limited(self) -> bool:
        """Whether the torque is at its limit now."""
        return self._limited > 0

    def check(self, samples: DriveSamples, command: float, following_error: float) -> FaultCode | None:
        """The fault in these samples, if any; `command` in rev/s, `following_error` in rev.

        The position limits apply to the position where the axis would come to standstill by the quick stop ramp,
        with the position window 6067h as tolerance.
        """
        limits = self._limits
        span = len(samples.speed) * self._cycle
        self._limited = self._limited + span if samples.torque_limited.all() else 0.0
        self._lagging = self._lagging + span if abs(following_error) > limits.following_window else 0.0
        ahead = float(samples.position[-1]) + command * abs(command) / (2 * limits.ramp(0x6085))
        low, high = limits.window
        tolerance = limits.position_window
        if (command > 0 and ahead > high + tolerance) or (command < 0 and ahead < low - tolerance):
            return FaultCode.POSITION_LIMIT
        if self._too_fast(samples):
            return FaultCode.SPEED_LIMIT
        if self._lagging > limits.following_time:
            return FaultCode.FOLLOWING
        return FaultCode.TORQUE_LIMIT if self._limited > 0.1 else None  # s at the torque limit

    def _too_fast(self, samples: DriveSamples) -> bool:
        """Whether the mean speed of the last 10 ms is 10 % above the limit."""
        self._speeds.extend(samples.speed.tolist())
        if len(self._speeds) * self._cycle < 0.01:
            return False
        mean = abs(float(np.mean(self._speeds)))
        self._speeds.clear()
        return mean > 1.1 * self._limits.speed


class VirtualAxis(PowerDrive):
    """One axis of the virtual drive."""

    def __init__(self, dictionary: ObjectDictionary, cycle: float, *, can_move: bool) -> None:
        super().__init__(dictionary, cycle, can_move=can_move)
        self.limits = DriveLimits(dictionary)
        self.speed_control = ControlParameters(dictionary)
        self.measuring = MeasuringFunction(dictionary, self.limits, cycle)
        self._cyclic_velocity = CyclicVelocity(dictionary, self.limits)
        dictionary.on_download((0x6060, 0), self._change_mode)
        dictionary.on_download((0x2100, 1), self._measure)
        self.reset()

    # Status

    @property
    def interpolating(self) -> bool:
        """Whether the set-points follow SYNC: mode 9, enabled, first SYNC seen, not braking."""
        return self.watch_until is not None

    @property
    def braking(self) -> bool:
        return self._motion is not None and self._ramping

    @property
    def moving(self) -> bool:
        """Whether a move, a ramp or the measuring function runs."""
        return self._motion is not None or self.measuring.driving

    @property
    def settling(self) -> bool:
        """Whether a move has not yet come to rest at its target (limited to a few seconds)."""
        return self._settling > 0

    @property
    def watch_until(self) -> float | None:
        """Time at which SYNC counts as missing, s; None while it is not monitored."""
        return self._cyclic_velocity.watch_until if self._cyclic else None

    @property
    def torque_limit(self) -> float:
        """Maximum torque of the drive, relative to the rated torque."""
        return min(self.limits.torque, self.disturbance.torque_cap)

    @property
    def _cyclic(self) -> bool:
        enabled = self.state is DriveState.OPERATION_ENABLED
        return enabled and self.mode is Mode.CYCLIC_VELOCITY and self._motion is None

    @property
    def _at_target(self) -> bool:
        if self.moving or abs(self.speed) > self.standstill:
            return False
        return self._target is None or abs(self._target - self.position) < self.limits.position_window

    # Cycles

    def sync(self, now: float) -> None:
        """A SYNC at `now`, s: the set-point received before it becomes the goal of the next cycle."""
        code = self._cyclic_velocity.sync(now) if self._cyclic else None
        if code is not None:
            self.fail(code)

    def watch(self, now: float) -> None:
        """Real time is now `now`, s: check whether SYNC is missing."""
        limit = self.watch_until
        if limit is not None and now > limit:
            self.fail(FaultCode.SYNC_MISSING)

    def injection(self, cycles: int) -> Array | None:
        """Torque to inject at the end of each of the next cycles (cycles,), N m; call before `setpoints`."""
        return self.measuring.injection(cycles) if self.measuring.injecting else None

    def setpoints(self, cycles: int) -> Array:
        """Speed set-points at the end of each of the next cycles (cycles,), rev/s."""
        if not self.energised:
            return np.zeros(cycles)
        if self.measuring.driving:
            speeds = self.measuring.setpoints(cycles)
            self._command = float(speeds[-1])
            return speeds
        if self._cyclic:
            goal = self._cyclic_velocity.goal
            speeds = self._command + (goal - self._command) * np.arange(1, cycles + 1) / cycles
            self._command = goal
            return speeds
        correction = 0.0
        speeds = np.zeros(cycles)
        if self._motion is not None:
            time = np.arange(1, cycles + 1, dtype=np.float64) * self._cycle
            speeds = self._motion.velocity(time + self._motion_time)
        if not self._ramping and self.mode is not Mode.CYCLIC_VELOCITY:
            correction = 10.0 * (self._reference() - self.position)  # 1/s, position controller
        self._motion_time += cycles * self._cycle
        self._settling -= cycles * self._cycle if self._motion is None else 0.0
        self._command = float(speeds[-1])
        limit = self.limits.speed
        return np.clip(speeds + correction, -limit, limit)

    def observe(self, samples: DriveSamples) -> None:
        self.position, self.speed = float(samples.position[-1]), float(samples.speed.mean())
        if self.energised:
            d, torque = self._dictionary, float(samples.torque.mean())
            d.set_actual(0x6077, round(torque * PER_MILLE * PER_MILLE / max(d[0x6076, 0], 1)))
            self._show(float(samples.position.mean()), float(samples.speed.mean()))
            recording = self.measuring.run is FunctionState.RUNNING and not self._ramping
            if recording:
                self.measuring.record(samples)
                if not self.measuring.driving:
                    self._hold()
            self._disturb(recording, len(samples.speed) * self._cycle)
            self._finish_motion()
            if self._at_target:
                self._settling = 0.0
            self._supervise(samples)
        self.publish()

    def _show(self, position: float, speed: float) -> None:
        """Actual position, rev, and speed, rev/s."""
        self._dictionary.set_actual(0x6064, round(position * INCREMENTS))
        self._dictionary.set_actual(0x606C, round(speed * self.limits.speed_unit))

    def _disturb(self, recording: bool, span: float) -> None:
        """Apply an ordered glitch or fault whose sample is among the last cycles, which took `span`, s."""
        recorded = self.measuring.count if recording else 0
        glitch, code = self.disturbance.take_glitch(recorded), self.disturbance.take_fault(recorded)
        if glitch is not None:
            d, off = self._dictionary, glitch.revolutions
            d.set_actual(0x6064, round(d[0x6064, 0] + off * INCREMENTS))
            d.set_actual(0x606C, round(d[0x606C, 0] + off / span * self.limits.speed_unit))
            if recorded and glitch.at_sample is not None:
                self.measuring.trace.falsify(glitch.at_sample, off)
            if abs(off) > self.limits.following_window:
                self.fail(FaultCode.ENCODER)
        if code is not None:
            self.fail(code)

    def _supervise(self, samples: DriveSamples) -> None:
        if self.state not in (DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE):
            return
        tracked = self.mode is not Mode.CYCLIC_VELOCITY and not self._ramping and not self.measuring.driving
        error = self._reference() - self.position if tracked else 0.0
        code = self._supervision.check(samples, self._command, error)
        if code is not None:
            self.fail(code)

    def _finish_motion(self) -> None:
        if self._motion is None or self._motion_time < self._motion.duration:
            return
        late = self._motion_time > self._motion.duration + self.patience
        if not self._ramping:
            self._origin += self._motion.distance
            self._motion, self._settling = None, 3.0  # s until it counts as at rest
        elif abs(self.speed) < self.standstill or late:
            self._motion = None
            self._hold()
            self.measuring.aborted()
            if self._after is not None:
                self._release(self._after)

    # As any power drive

    def stop_safely(self, *, on: bool) -> None:
        self._dictionary[0x2130, 1] = int(on)
        super().stop_safely(on=on)

    def publish(self) -> None:
        positioning = self.state is DriveState.OPERATION_ENABLED and self.mode is Mode.PROFILE_POSITION
        stopped = self.state is DriveState.QUICK_STOP_ACTIVE and not self.moving
        bits = {
            0x0010: not self.emergency_stop,
            0x0400: stopped or (positioning and self._at_target),
            0x0800: self._supervision.limited,
            0x1000: self._cyclic or (positioning and self._acknowledged),
            0x2000: self.errors.code == FaultCode.FOLLOWING,
        }
        self._dictionary[0x6041, 0] = int(self.state) | 0x200 | sum(bit for bit, on in bits.items() if on)
        self._dictionary[0x6061, 0] = int(self.mode)

    def _power_on(self) -> None:
        self.mode = Mode.NONE
        self.measuring.reset()
        self._cyclic_velocity.restart()
        self._supervision = Supervision(self.limits, self._cycle)
        self._hold()
        self._motion_time = 0.0
        self._target: float | None = None  # of the last move, rev
        self._rest()

    def _begin(self, *, again: bool) -> None:
        if not again:
            self._supervision = Supervision(self.limits, self._cycle)
        self._enter_mode()

    def _enter_mode(self) -> None:
        """Start the mode from standstill: hold the position, no set-point yet."""
        self._hold()
        self._target = None
        self._cyclic_velocity.restart()
        if self.mode is Mode.CYCLIC_VELOCITY and not self._cyclic_velocity.period_agrees:
            self.fail(FaultCode.PARAMETER)

    def _change_mode(self, value: int) -> None:
        if value not in (Mode.NONE, Mode.PROFILE_POSITION, Mode.CYCLIC_VELOCITY):
            raise SdoAbort(AbortCode.VALUE)
        if value == self.mode:
            return
        if self.moving or abs(self._command) > 0:
            raise SdoAbort(AbortCode.STATE)
        self.mode = Mode(value)
        if self.state is DriveState.OPERATION_ENABLED:
            self._enter_mode()
        self.publish()

    def _operate(self, before: int) -> None:
        now = self._controlword
        if now & 0x100 and self.moving and not self._ramping:
            self._brake(fast=self._dictionary[0x605D, 0] == 2, then=None)
        if self.mode is not Mode.PROFILE_POSITION:
            return
        if now & ~before & 0x10 and not now & 0x100 and not self.measuring.driving:
            self._move(relative=bool(now & 0x40))
            self._acknowledged = True
        elif not now & 0x10:
            self._acknowledged = False

    def _move(self, *, relative: bool) -> None:
        present = self._reference() if not self._ramping else self.position
        target = self._dictionary[0x607A, 0] / INCREMENTS
        if relative:
            target += present if self._target is None else self._target
        low, high = self.limits.window
        if not low <= target <= high:
            self.fail(FaultCode.POSITION_LIMIT)
            return
        limit = self.limits.profile_speed
        if limit == 0.0:
            return
        self._target = target
        self._origin, self._motion_time, self._ramping = present, 0.0, False
        up, down = self.limits.ramp(0x6083), self.limits.ramp(0x6084)
        self._motion = travel(target - present, self._command, limit, up, down)

    def _measure(self, command: int) -> None:
        if command == 1:
            if self.measuring.run is FunctionState.RUNNING:
                raise SdoAbort(AbortCode.STATE)
            enabled = self.state is DriveState.OPERATION_ENABLED
            ready = enabled and not self.moving and self.mode is not Mode.CYCLIC_VELOCITY
            self.measuring.start(self.position, ready=ready)
        elif command == 2 and self.measuring.driving:
            self._brake(fast=True, then=None)
        self.publish()

    def _ramp_down(self, *, fast: bool) -> None:
        self.measuring.stop()
        self._motion = brake(self._command, self.limits.ramp(0x6085 if fast else 0x6084))
        self._motion_time, self._ramping = 0.0, True

    def _stand(self) -> None:
        self.measuring.stop()
        self.measuring.aborted()
        self._hold()
        self._rest()

    def _rest(self) -> None:
        """Actual values without torque."""
        self._show(self.position, 0.0)
        self._dictionary.set_actual(0x6077, 0)

    def _give_way(self) -> None:
        self.speed_control.restore()

    def _hold(self) -> None:
        self._motion: RampProfile | None = None  # a move, or a ramp to standstill
        self._ramping = False  # the motion is a ramp
        self._settling = 0.0  # s remaining to come to rest after a move
        self._origin = self.position  # start position of the motion, or position held
        self._command = 0.0  # speed set-point at the end of the cycles so far

    def _reference(self) -> float:
        """Present set-point of the position, rev."""
        if self._motion is None or self._ramping:
            return self._origin
        return self._origin + float(self._motion.position(np.array([self._motion_time]))[0])
