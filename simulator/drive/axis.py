"""The behaviour of one axis: CiA 402 states, modes and supervision over a dictionary. No I/O, no clock, no plant.

Inputs: controlword and set-points (through the dictionary), orders, and the samples of the last cycles. Outputs:
`energised`, the next speed set-points, and values in the dictionary. Positions in rev, speeds in rev/s of the motor.
"""

import numpy as np
from numpy.typing import NDArray

from simulator.drive.actual_values import ActualValues
from simulator.drive.cyclic import CyclicVelocity
from simulator.drive.dictionary import Abort, AbortCode, Dictionary
from simulator.drive.disturbance import Disturbance
from simulator.drive.errors import ErrorCode, ErrorLog
from simulator.drive.limits import Limits
from simulator.drive.measuring import MeasuringFunction, Run, Samples
from simulator.drive.profile import Motion, brake, travel
from simulator.drive.speed_control import SpeedControl
from simulator.drive.states import ENERGISED, TRANSITIONS, Command, Mode, State, command_of, fault_reset
from simulator.drive.supervision import Supervision
from simulator.drive.units import INCREMENTS

Array = NDArray[np.float64]

_POSITION_GAIN = 10.0  # 1/s, position controller of mode 1 and at standstill
_STANDSTILL = 0.5 / 60  # rev/s; below that a ramp has ended
_PATIENCE = 0.5  # s after the end of a ramp until the brake closes regardless of the speed
_SETTLING = 3.0  # s after the end of a move until it counts as at rest


class Axis:
    """One axis. `can_move` is False if the machine has no power section for it."""

    def __init__(self, dictionary: Dictionary, cycle: float, *, can_move: bool) -> None:
        self._dictionary = dictionary
        self._cycle = cycle
        self._can_move = can_move
        self.errors = ErrorLog(dictionary)
        self.limits = Limits(dictionary)
        self._actual = ActualValues(dictionary, self.limits)
        self.speed_control = SpeedControl(dictionary)
        self.measuring = MeasuringFunction(dictionary, self.limits, cycle)
        self._cyclic_velocity = CyclicVelocity(dictionary, self.limits)
        self.position = 0.0
        self.speed = 0.0
        self.emergency_stop = False
        self.disturbance = Disturbance()
        dictionary.on_download((0x6040, 0), self.control)
        dictionary.on_download((0x6060, 0), self._change_mode)
        dictionary.on_download((0x2100, 1), self._measure)
        self.reset()

    def reset(self) -> None:
        """Power-on: no torque. Only the position, safe torque off and the limit switch are kept."""
        self.state = State.SWITCH_ON_DISABLED
        self.mode = Mode.NONE
        self.measuring.reset()
        self._cyclic_velocity.restart()
        self._supervision = Supervision(self.limits, self._cycle)
        self._controlword = 0
        self.speed = 0.0
        self._hold()
        self._motion_time = 0.0
        self._after: State | None = None  # state at the end of the ramp
        self._target: float | None = None  # of the last move, rev
        self._acknowledged = False
        self._actual.stand(self.position)
        if self.disturbance.limit_switch:
            self.hit_limit_switch(on=True)
        if self.emergency_stop:
            self.stop_safely(on=True)
        self._publish()

    # Status

    @property
    def energised(self) -> bool:
        """Torque on, brake open."""
        return self.state in ENERGISED

    @property
    def interpolating(self) -> bool:
        """Whether the set-points follow SYNC: mode 9, enabled, first SYNC seen, not braking."""
        return self.watch_until is not None

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
        return self.state is State.OPERATION_ENABLED and self.mode is Mode.CYCLIC_VELOCITY and self._motion is None

    # Commands

    def control(self, controlword: int) -> None:
        """Process a controlword (6040h)."""
        before, self._controlword = self._controlword, controlword
        if self.state is State.FAULT:
            if fault_reset(before, controlword) and not self.emergency_stop and not self.disturbance.limit_switch:
                self.state = State.SWITCH_ON_DISABLED
                self.errors.clear()
        else:
            self._obey(command_of(controlword))
            if self.state is State.OPERATION_ENABLED and self._after is None:
                self._operate(before)
        self._publish()

    def fail(self, code: int) -> None:
        """Enter a fault and react as set in 605Eh; ends in FAULT, with the commissioned speed control restored."""
        self.errors.enter(code)
        self.speed_control.restore()
        if self.state not in (State.FAULT, State.FAULT_REACTION_ACTIVE):
            option = self._dictionary[0x605E, 0]
            if self.energised and option:
                self.state = State.FAULT_REACTION_ACTIVE
                self._brake(fast=option == 2, then=State.FAULT)
            else:
                self._release(State.FAULT)
        self._publish()

    def quick_stop(self) -> None:
        """Quick stop of an enabled axis as set in 605Ah; other states do not change."""
        if self.state is State.OPERATION_ENABLED:
            self._obey(Command.QUICK_STOP)
            self._publish()

    def disable_voltage(self) -> None:
        """Torque off now."""
        if self.state is not State.FAULT:
            self._obey(Command.DISABLE_VOLTAGE)
            self._publish()

    def stop_safely(self, *, on: bool) -> None:
        """Safe torque off: immediate loss of torque, FAULT; no reset until it is released."""
        self.emergency_stop = on
        self._dictionary[0x2130, 1] = int(on)
        if on:
            self.errors.enter(ErrorCode.EMERGENCY_STOP)
            self.speed_control.restore()
            self._release(State.FAULT)
        self._publish()

    def hit_limit_switch(self, *, on: bool) -> None:
        """Hardware limit switch: a fault, and no reset until it is free again."""
        self.disturbance.limit_switch = on
        if on:
            self.fail(ErrorCode.LIMIT_SWITCH)

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
            self.fail(ErrorCode.SYNC_MISSING)

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
            correction = _POSITION_GAIN * (self._reference() - self.position)
        self._motion_time += cycles * self._cycle
        self._settling -= cycles * self._cycle if self._motion is None else 0.0
        self._command = float(speeds[-1])
        limit = self.limits.speed
        return np.clip(speeds + correction, -limit, limit)

    def observe(self, samples: Samples) -> None:
        """Samples of the last cycles."""
        self.position, self.speed = float(samples.position[-1]), float(samples.speed.mean())
        if self.energised:
            self._actual.update(samples)
            recording = self.measuring.run is Run.RUNNING and not self._ramping
            if recording:
                self.measuring.record(samples)
                if not self.measuring.driving:
                    self._hold()
            self._disturb(recording, len(samples.speed) * self._cycle)
            self._finish_motion()
            if self._at_target:
                self._settling = 0.0
            self._supervise(samples)
        self._publish()

    def _disturb(self, recording: bool, span: float) -> None:
        """Apply an ordered glitch or fault whose sample is among the last cycles, which took `span`, s."""
        recorded = self.measuring.count if recording else 0
        glitch, code = self.disturbance.take_glitch(recorded), self.disturbance.take_fault(recorded)
        if glitch is not None:
            self._actual.glitch(glitch.revolutions, span)
            if recorded and glitch.at_sample is not None:
                self.measuring.falsify(glitch.at_sample, glitch.revolutions)
            if abs(glitch.revolutions) > self.limits.following_window:
                self.fail(ErrorCode.ENCODER)
        if code is not None:
            self.fail(code)

    def _supervise(self, samples: Samples) -> None:
        if self.state not in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE):
            return
        tracked = self.mode is not Mode.CYCLIC_VELOCITY and not self._ramping and not self.measuring.driving
        error = self._reference() - self.position if tracked else 0.0
        code = self._supervision.check(samples, self._command, error)
        if code is not None:
            self.fail(code)

    def _finish_motion(self) -> None:
        if self._motion is None or self._motion_time < self._motion.duration:
            return
        late = self._motion_time > self._motion.duration + _PATIENCE
        if not self._ramping:
            self._origin += self._motion.distance
            self._motion, self._settling = None, _SETTLING
        elif abs(self.speed) < _STANDSTILL or late:
            self._motion = None
            self._hold()
            self.measuring.aborted()
            if self._after is not None:
                self._release(self._after)

    # Internal

    def _obey(self, command: Command | None) -> None:
        to = None if command is None else TRANSITIONS.get(self.state, {}).get(command)
        if to is None:
            return
        d = self._dictionary
        if to is State.OPERATION_ENABLED:
            self._enable()
        elif command is Command.QUICK_STOP and self.state is State.OPERATION_ENABLED:
            option = d[0x605A, 0]
            if option == 0:
                self._release(State.SWITCH_ON_DISABLED)
            else:
                self.state = State.QUICK_STOP_ACTIVE
                self._brake(fast=option not in (1, 5), then=None if option > 4 else State.SWITCH_ON_DISABLED)
        elif command in (Command.SHUTDOWN, Command.SWITCH_ON) and self.state is State.OPERATION_ENABLED:
            if not d[0x605B if command is Command.SHUTDOWN else 0x605C, 0]:
                self._release(to)
            elif self._after is None:
                self._brake(fast=False, then=to)
        else:
            self._release(to)

    def _enable(self) -> None:
        if not self._can_move:
            self.fail(ErrorCode.NO_POWER_SECTION)
        elif self.state is not State.QUICK_STOP_ACTIVE:
            self.state = State.OPERATION_ENABLED
            self._supervision = Supervision(self.limits, self._cycle)
            self._enter_mode()
        elif self._after is None and self._motion is None:
            self.state = State.OPERATION_ENABLED
            self._enter_mode()

    def _enter_mode(self) -> None:
        """Start the mode from standstill: hold the position, no set-point yet."""
        self._hold()
        self._target = None
        self._cyclic_velocity.restart()
        if self.mode is Mode.CYCLIC_VELOCITY and not self._cyclic_velocity.period_agrees:
            self.fail(ErrorCode.PARAMETER)

    def _change_mode(self, value: int) -> None:
        if value not in tuple(Mode):
            raise Abort(AbortCode.VALUE)
        if value == self.mode:
            return
        if self.moving or abs(self._command) > 0:
            raise Abort(AbortCode.STATE)
        self.mode = Mode(value)
        if self.state is State.OPERATION_ENABLED:
            self._enter_mode()
        self._publish()

    def _operate(self, before: int) -> None:
        """Process the bits of the controlword that belong to the mode."""
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
            self.fail(ErrorCode.POSITION_LIMIT)
            return
        limit = self.limits.profile_speed
        if limit == 0.0:
            return
        self._target = target
        self._origin, self._motion_time, self._ramping = present, 0.0, False
        up, down = self.limits.acceleration, self.limits.deceleration
        self._motion = travel(target - present, self._command, limit, up, down)

    def _measure(self, command: int) -> None:
        if command == 1:
            if self.measuring.run is Run.RUNNING:
                raise Abort(AbortCode.STATE)
            ready = self.state is State.OPERATION_ENABLED and not self.moving and self.mode is not Mode.CYCLIC_VELOCITY
            self.measuring.start(self.position, ready=ready)
        elif command == 2 and self.measuring.driving:
            self._brake(fast=True, then=None)
        self._publish()

    def _brake(self, *, fast: bool, then: State | None) -> None:
        """Ramp to standstill, then `then` (None: stay in this state and hold)."""
        self.measuring.stop()
        self._motion = brake(self._command, self.limits.quick_deceleration if fast else self.limits.deceleration)
        self._motion_time, self._ramping, self._after = 0.0, True, then

    def _release(self, to: State) -> None:
        """Torque off, brake closed: the axis stands."""
        self.state = to
        self.measuring.stop()
        self.measuring.aborted()
        self._hold()
        self._after = None
        self.speed = 0.0
        self._actual.stand(self.position)

    def _hold(self) -> None:
        self._motion: Motion | None = None  # a move, or a ramp to standstill
        self._ramping = False  # the motion is a ramp
        self._settling = 0.0  # s remaining to come to rest after a move
        self._origin = self.position  # start position of the motion, or position held
        self._command = 0.0  # speed set-point at the end of the cycles so far

    def _reference(self) -> float:
        """Present set-point of the position, rev."""
        if self._motion is None or self._ramping:
            return self._origin
        return self._origin + float(self._motion.position(np.array([self._motion_time]))[0])

    def _publish(self) -> None:
        positioning = self.state is State.OPERATION_ENABLED and self.mode is Mode.PROFILE_POSITION
        stopped = self.state is State.QUICK_STOP_ACTIVE and not self.moving
        bits = {
            0x0010: not self.emergency_stop,
            0x0400: stopped or (positioning and self._at_target),
            0x0800: self._supervision.limited,
            0x1000: self._cyclic or (positioning and self._acknowledged),
            0x2000: self._dictionary[0x603F, 0] == ErrorCode.FOLLOWING,
        }
        self._dictionary[0x6041, 0] = int(self.state) | 0x200 | sum(bit for bit, on in bits.items() if on)
        self._dictionary[0x6061, 0] = int(self.mode)

    @property
    def _at_target(self) -> bool:
        if self.moving or abs(self.speed) > _STANDSTILL:
            return False
        return self._target is None or abs(self._target - self.position) < self.limits.position_window
