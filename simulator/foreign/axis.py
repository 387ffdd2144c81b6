"""The behaviour of one foreign drive: the CiA 402 state machine, its faults and limits over an exact dictionary.

Inputs: objects written by the bus, and the samples of the last cycles. Outputs: `energised`, speed set-points,
torque added to that of the speed controller, and actual values. Positions in rev, speeds in rev/s, torque in N m of
the motor.
"""

from math import copysign

import numpy as np
from numpy.typing import NDArray

from simulator.drive.dictionary import Abort, AbortCode
from simulator.drive.disturbance import Disturbance
from simulator.drive.measuring import Samples
from simulator.drive.states import ENERGISED, TRANSITIONS, Command, State, command_of, fault_reset
from simulator.foreign.dictionary import ForeignDictionary
from simulator.foreign.faults import ErrorCode, ErrorLog
from simulator.foreign.modes import CYCLIC, Guide, Mode, supported
from simulator.foreign.statusword import set_actual_values, statusword
from simulator.foreign.units import Plate, Units

Array = NDArray[np.float64]

_STANDSTILL = 0.5 / 60  # rev/s; below that a ramp has ended
_PATIENCE = 0.5  # s after the end of a ramp until the torque is switched off regardless of the speed
_OVERSPEED = 0.1  # share of the motor's maximum speed, above the limit
_STAYS = 4  # with option codes of quick stop above it the drive stays in QUICK STOP ACTIVE
_SLOW_STOPS = (1, 5)


class Axis:
    """One axis. `can_move` is False if the machine has no power section for it."""

    def __init__(self, dictionary: ForeignDictionary, plate: Plate, cycle: float, *, can_move: bool) -> None:
        self._dictionary = dictionary
        self._cycle = cycle
        self._can_move = can_move
        self.units = Units(dictionary, plate)
        self.errors = ErrorLog(dictionary)
        self.guide = Guide(dictionary, self.units, cycle)
        self.disturbance = Disturbance()
        self.position = self.speed = 0.0
        self.torque = 0.0
        self.emergency_stop = False
        dictionary.on_download((0x6060, 0), self._ask_mode)
        dictionary.on_download((0x6040, 0), self.control)
        self.reset()

    def reset(self) -> None:
        """Power-on: no torque. Only the position, safe torque off and the limit switch are kept."""
        self.state = State.SWITCH_ON_DISABLED
        self.errors.reset()
        self._controlword = 0
        self._after: State | None = None  # state at the end of the ramp
        self._acknowledged = False
        self._lagging = 0.0  # s outside the following window
        self.speed = self.torque = 0.0
        self.mode = Mode.NONE
        self._take_mode(self._dictionary[0x6060, 0])
        if self.disturbance.limit_switch:
            self.hit_limit_switch(on=True)
        if self.emergency_stop:
            self.stop_safely(on=True)
        self.publish()

    @property
    def energised(self) -> bool:
        """Torque on, brake open."""
        return self.state in ENERGISED

    @property
    def following(self) -> bool:
        """Whether set-points of a host move the axis: enabled in a cyclic mode, and not braking."""
        fed = self.mode in CYCLIC or self.mode is Mode.PROFILE_VELOCITY
        return self.state is State.OPERATION_ENABLED and fed and not self.guide.stopped

    @property
    def moving(self) -> bool:
        """Whether a move, a ramp or a speed is commanded, or the axis has not yet come to rest."""
        return self.energised and (self.guide.moving or abs(self.speed) > _STANDSTILL)

    @property
    def torque_limit(self) -> float:
        """Maximum torque of the drive, N m."""
        return min(self.units.torque_limit, self.disturbance.torque_cap * self.units.plate.rated_torque)

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
        self.publish()

    def fail(self, code: int) -> None:
        """Enter a fault and react as set in 605Eh; the axis ends in FAULT."""
        self.errors.enter(code)
        if self.state not in (State.FAULT, State.FAULT_REACTION_ACTIVE):
            option = self._dictionary[0x605E, 0]
            if self.energised and option:
                self.state = State.FAULT_REACTION_ACTIVE
                self._brake(fast=option != 1, then=State.FAULT)
            else:
                self._release(State.FAULT)
        self.publish()

    def lose_connection(self) -> None:
        """React as set in the abort connection option code 6007h."""
        match self._dictionary[0x6007, 0]:
            case 1:
                self.fail(ErrorCode.HEARTBEAT)
            case 2:
                self.disable_voltage()
            case 3:
                self.quick_stop()
            case _:
                pass

    def quick_stop(self) -> None:
        """Quick stop of an enabled axis as set in 605Ah; other states do not change."""
        if self.state is State.OPERATION_ENABLED:
            self._obey(Command.QUICK_STOP)
            self.publish()

    def disable_voltage(self) -> None:
        """Torque off now."""
        if self.state is not State.FAULT:
            self._obey(Command.DISABLE_VOLTAGE)
            self.publish()

    def stop_safely(self, *, on: bool) -> None:
        """Safe torque off: immediate loss of torque, FAULT; no reset until it is released."""
        self.emergency_stop = on
        if on:
            self.errors.enter(ErrorCode.EMERGENCY_STOP)
            self._release(State.FAULT)
        self.publish()

    def hit_limit_switch(self, *, on: bool) -> None:
        """Hardware limit switch: a fault, and no reset until it is free again."""
        self.disturbance.limit_switch = on
        if on:
            self.fail(ErrorCode.LIMIT_SWITCH)

    # Cycles

    def setpoints(self, cycles: int) -> Array:
        """Speed set-points at the end of each of the next cycles (cycles,), rev/s."""
        return self.guide.setpoints(cycles, self.position) if self.energised else np.zeros(cycles)

    def injection(self) -> float:
        """Torque offset 60B2h of the cyclic modes, N m."""
        offset = self._dictionary.get(0x60B2)
        return offset * 1e-3 * self.units.rated_torque if offset and self.following and self.mode in CYCLIC else 0.0

    def observe(self, samples: Samples) -> None:
        """Samples of the last cycles."""
        self.position, self.speed = float(samples.position[-1]), float(samples.speed.mean())
        self.torque = float(samples.torque.mean())
        span = len(samples.speed) * self._cycle
        glitch, code = self.disturbance.take_glitch(0), self.disturbance.take_fault()
        off = 0.0 if glitch is None else glitch.revolutions
        set_actual_values(self._dictionary, self.units, self.guide, samples, off, span)
        if abs(off) > self.units.following_window:
            code = ErrorCode.ENCODER
        if code is None:
            code = self._supervise(samples, span)
        if code is not None and self.energised:
            self.fail(code)
        self._finish()
        self.publish()

    def _supervise(self, samples: Samples, span: float) -> int | None:
        if self.state is not State.OPERATION_ENABLED or self.guide.ramping:
            return None
        command, units = self.guide.command, self.units
        lag = abs(self.guide.reference - self.position) if self.guide.tracking else 0.0
        self._lagging = self._lagging + span if lag > units.following_window else 0.0
        if self._lagging > self._dictionary.get(0x6066) * 1e-3:
            return ErrorCode.FOLLOWING
        most = units.speed_limit + _OVERSPEED * units.plate.most_speed
        ahead = self.position + copysign(command**2 / (2 * units.ramp(0x6085)), command)
        low, high = units.window
        if not self.guide.tracking and ((command > 0 and ahead > high) or (command < 0 and ahead < low)):
            return self._dictionary.maker.position_limit_code
        return ErrorCode.SPEED_LIMIT if abs(self.speed) > most else None

    def _finish(self) -> None:
        self.guide.finish()
        since = self.guide.ended
        if since is not None and (abs(self.speed) < _STANDSTILL or since > _PATIENCE):
            self.guide.hold(self.position)
            if self._after is not None:
                self._release(self._after)
            elif self.state is State.OPERATION_ENABLED and not self.guide.halted:
                self.guide.resume()
        if self.mode != self._asked and not self.moving:
            self._take_mode(self._asked)

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
                stays = option > _STAYS
                self._brake(fast=option not in _SLOW_STOPS, then=None if stays else State.SWITCH_ON_DISABLED)
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
        elif self.state is not State.QUICK_STOP_ACTIVE or (self._after is None and not self.guide.ramping):
            self.state = State.OPERATION_ENABLED
            self._lagging = 0.0
            self.guide.start(self.mode, self.position)

    def _ask_mode(self, value: int) -> None:
        if not supported(self._dictionary[0x6502, 0], value):
            if self._dictionary.maker.refuses_modes:
                raise Abort(AbortCode.VALUE)
            return
        self._asked = Mode(value)
        if not self.moving:
            self._take_mode(value)
        self.publish()

    def _take_mode(self, value: int) -> None:
        self._asked = self.mode = Mode(value) if supported(self._dictionary[0x6502, 0], value) else Mode.NONE
        self.guide.start(self.mode, self.position)

    def _operate(self, before: int) -> None:
        """Process the bits of the controlword that belong to the mode."""
        now, guide = self._controlword, self.guide
        guide.halted = bool(now & 0x100)
        if before & ~now & 0x100 and not guide.ramping:
            guide.resume()
        if now & ~before & 0x100 and guide.moving and not guide.ramping and self.mode is not Mode.PROFILE_VELOCITY:
            self._brake(fast=self._dictionary[0x605D, 0] == 2, then=None)
        if self.mode is Mode.INTERPOLATED_POSITION:
            guide.running = bool(now & 0x10) and not guide.halted
        if self.mode is not Mode.PROFILE_POSITION:
            return
        if not now & 0x10:
            self._acknowledged = False
        elif not before & 0x10 and not guide.halted:
            target = self._dictionary[0x607A, 0] / self.units.position
            guide.move(self.position, target, relative=bool(now & 0x40))
            self._acknowledged = True

    def _brake(self, *, fast: bool, then: State | None) -> None:
        """Ramp to standstill, then `then` (None: stay in this state and hold)."""
        self.guide.ramp_down(self.units.ramp(0x6085 if fast else 0x6084))
        self._after = then

    def _release(self, to: State) -> None:
        """Torque off, brake closed: the axis stands."""
        self.state = to
        self._after = None
        self.speed = self.torque = 0.0
        self.guide.hold(self.position)

    def publish(self) -> None:
        """Set statusword, mode and, without torque, actual values; call after any change of them or of their units."""
        self._dictionary.set_actual(0x6041, statusword(self, acknowledged=self._acknowledged))
        self._dictionary.set_actual(0x6061, int(self.mode))
        if not self.energised:
            self._dictionary.set_actual(0x6064, round(self.position * self.units.position))
            for index in (0x606C, 0x6077, 0x6078, 0x6074, 0x606B):
                self._dictionary.set_actual(index, 0)
