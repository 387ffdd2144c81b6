"""What every CiA 402 drive has in common: the finite state automaton (CiA 402-2, figure 1), faults, ramps, orders.

No I/O, no clock, no plant. A maker's axis (`virtual_axis`, `foreign_axis`) adds modes, limits and actual values.
Positions in rev, speeds in rev/s, torque in N m of the motor.
"""

import struct
from dataclasses import dataclass
from enum import Enum, IntEnum
from math import inf

from simulator.drive.dictionary import AbortCode, ObjectDictionary, SdoAbort


class DriveState(IntEnum):
    """The eight states; the value is the statusword under its mask."""

    NOT_READY_TO_SWITCH_ON = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


class Mode(IntEnum):
    """Modes of operation, 6060h, that move an axis here. Other modes of a drive are refused like unsupported ones."""

    NONE = 0
    PROFILE_POSITION = 1
    PROFILE_VELOCITY = 3
    INTERPOLATED_POSITION = 7
    CYCLIC_POSITION = 8
    CYCLIC_VELOCITY = 9


class Command(Enum):
    """Commands in a controlword. (mask, value); checked in this order."""

    DISABLE_VOLTAGE = (0x82, 0x00)
    QUICK_STOP = (0x86, 0x02)
    SHUTDOWN = (0x87, 0x06)
    SWITCH_ON = (0x8F, 0x07)  # in OPERATION ENABLED: disable operation
    ENABLE_OPERATION = (0x8F, 0x0F)


ENERGISED = frozenset({DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT_REACTION_ACTIVE})
"""States with torque on and brake open."""

TRANSITIONS: dict[DriveState, dict[Command, DriveState]] = {
    DriveState.SWITCH_ON_DISABLED: {Command.SHUTDOWN: DriveState.READY_TO_SWITCH_ON},
    DriveState.READY_TO_SWITCH_ON: {
        Command.DISABLE_VOLTAGE: DriveState.SWITCH_ON_DISABLED,
        Command.QUICK_STOP: DriveState.SWITCH_ON_DISABLED,
        Command.SWITCH_ON: DriveState.SWITCHED_ON,
        Command.ENABLE_OPERATION: DriveState.OPERATION_ENABLED,  # transitions 3 and 4 together
    },
    DriveState.SWITCHED_ON: {
        Command.DISABLE_VOLTAGE: DriveState.SWITCH_ON_DISABLED,
        Command.QUICK_STOP: DriveState.SWITCH_ON_DISABLED,
        Command.SHUTDOWN: DriveState.READY_TO_SWITCH_ON,
        Command.ENABLE_OPERATION: DriveState.OPERATION_ENABLED,
    },
    DriveState.OPERATION_ENABLED: {
        Command.DISABLE_VOLTAGE: DriveState.SWITCH_ON_DISABLED,
        Command.QUICK_STOP: DriveState.QUICK_STOP_ACTIVE,
        Command.SHUTDOWN: DriveState.READY_TO_SWITCH_ON,
        Command.SWITCH_ON: DriveState.SWITCHED_ON,
    },
    DriveState.QUICK_STOP_ACTIVE: {
        Command.DISABLE_VOLTAGE: DriveState.SWITCH_ON_DISABLED,
        Command.ENABLE_OPERATION: DriveState.OPERATION_ENABLED,  # transition 16, at standstill only
    },
}
"""Commanded transitions; other pairs change nothing. Faults and their reset are not commands."""


def command_of(controlword: int) -> Command | None:
    """The command in the controlword's bits 0 to 3 and 7; None while bit 7 is set."""
    for command in Command:
        mask, value = command.value
        if controlword & mask == value:
            return command
    return None


def fault_reset(before: int, now: int) -> bool:
    """Whether bit 7 rises."""
    return bool(now & ~before & 0x80)


class FaultCode(IntEnum):
    """Error codes (CiA 301, table 26; CiA 402-2; 9000h external, FFxxh manufacturer-specific)."""

    TORQUE_LIMIT = 0x2310
    NO_POWER_SECTION = 0x5400
    PARAMETER = 0x6320
    ENCODER = 0x7305
    HEARTBEAT = 0x8130
    PDO_TOO_SHORT = 0x8210
    PDO_TOO_LONG = 0x8220
    SYNC_LENGTH = 0x8240
    SET_POINT_MISSING = 0x8250
    SPEED_LIMIT = 0x8400
    FOLLOWING = 0x8611
    POSITION_LIMIT = 0x8612
    SYNC_MISSING = 0x8700
    EMERGENCY_STOP = 0x9000
    LIMIT_SWITCH = 0xFF10


class FaultLog:
    """Error objects, if the drive has them (603Fh, 1001h, 1003h), and the emergency messages not sent yet
    (CiA 301, 7.2.7).
    """

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self._messages: list[bytes] = []
        dictionary.on_download((0x1003, 0), self._clear_history)
        self.reset()

    def reset(self) -> None:
        """As at power-on."""
        self.code = self.register = 0
        self._history: list[int] = []

    def enter(self, code: int) -> None:
        """A new error: 603Fh, 1001h, first of 1003h, EMCY."""
        registers = self._dictionary.maker.registers
        self.code = code
        self.register |= registers.get(code, registers.get(code >> 8, 0x21))
        self._history = [code, *self._history][: max(len(self._dictionary.keys(0x1003)) - 1, 0)]
        self._publish()
        self.announce(code)

    def announce(self, code: int) -> None:
        """Only an emergency message: no error in the dictionary, no fault state."""
        self._messages.append(struct.pack("<HB5x", code, self.register))

    def clear(self) -> None:
        """The fault was reset: EMCY with code 0; the history is kept."""
        self.code = self.register = 0
        self._publish()
        self.announce(0)

    def take_messages(self) -> list[bytes]:
        """Emergency messages not sent yet, oldest first."""
        messages, self._messages = self._messages, []
        return messages

    def _publish(self) -> None:
        d = self._dictionary
        d.set_actual(0x603F, self.code)
        d.set_actual(0x1001, self.register)
        d.set_actual(0x1003, len(self._history))
        for sub in range(1, len(d.keys(0x1003))):
            d.set_actual(0x1003, self._history[sub - 1] if sub <= len(self._history) else 0, sub)

    def _clear_history(self, value: int) -> None:
        if value:
            raise SdoAbort(AbortCode.VALUE)  # only 0 may be written (CiA 301, 7.5.2.6)
        self._history = []
        self._publish()


@dataclass(frozen=True, slots=True)
class OrderedFault:
    """A fault that occurs at trace sample `at_sample` or SYNC counter `at_counter`."""

    code: int
    at_sample: float = inf
    at_counter: float = inf


@dataclass(frozen=True, slots=True)
class Glitch:
    """One sample of the motor encoder is wrong by `revolutions`: trace sample `at_sample`, or the next one."""

    revolutions: float
    at_sample: int | None = None


@dataclass(slots=True)
class Disturbance:
    """Initially without disturbance. A boot of the node does not change it."""

    mute: bool = False
    counter_frozen: bool = False
    limit_switch: bool = False
    torque_cap: float = inf  # relative to the rated torque, maximum of the power section
    fault: OrderedFault | None = None
    glitch: Glitch | None = None
    drop_tpdos: int = 0  # frames still to be lost
    duplicate_tpdos: int = 0  # SYNCs whose TPDOs are still to be sent twice
    delay_tpdos: int = 0  # SYNCs whose TPDOs are still to be sent late ...
    delay_cycles: int = 0  # ... by this number of SYNCs

    def take_fault(self, recorded: int = 0, counter: int = 0) -> int | None:
        """The code of the ordered fault if it is due at this number of recorded samples or counted SYNCs."""
        fault = self.fault
        if fault is None or (recorded <= fault.at_sample and counter < fault.at_counter):
            return None
        self.fault = None
        return fault.code

    def take_glitch(self, recorded: int) -> Glitch | None:
        """The ordered glitch if it is due at this number of recorded samples, and the sample that it affects."""
        glitch = self.glitch
        if glitch is None or (glitch.at_sample is not None and recorded <= glitch.at_sample):
            return None
        self.glitch = None
        return glitch if glitch.at_sample is not None else Glitch(glitch.revolutions, recorded - 1)


class PowerDrive:
    """The state automaton of one axis over its dictionary. `can_move` is False without a power section.

    A maker's axis says how it begins a mode, which bits of the controlword belong to it, how it ramps down, and what
    it publishes.
    """

    standstill = 0.5 / 60
    """rev/s; below that a ramp has ended."""
    patience = 0.5
    """s after the end of a ramp until it counts as ended regardless of the speed."""

    def __init__(self, dictionary: ObjectDictionary, cycle: float, *, can_move: bool) -> None:
        self._dictionary = dictionary
        self._cycle = cycle
        self._can_move = can_move
        self.errors = FaultLog(dictionary)
        self.disturbance = Disturbance()
        self.position = self.speed = 0.0
        self.emergency_stop = False
        self.mode = Mode.NONE
        self.state = DriveState.SWITCH_ON_DISABLED
        self._controlword = 0
        self._after: DriveState | None = None  # state at the end of the ramp
        self._acknowledged = False
        dictionary.on_download((0x6040, 0), self.control)

    def reset(self) -> None:
        """Power-on: no torque. Only the position, safe torque off and the limit switch are kept."""
        self.state = DriveState.SWITCH_ON_DISABLED
        self.errors.reset()
        self._controlword = 0
        self._after = None
        self._acknowledged = False
        self.speed = 0.0
        self._power_on()
        if self.disturbance.limit_switch:
            self.hit_limit_switch(on=True)
        if self.emergency_stop:
            self.stop_safely(on=True)
        self.publish()

    @property
    def energised(self) -> bool:
        """Torque on, brake open."""
        return self.state in ENERGISED

    def control(self, controlword: int) -> None:
        """Process a controlword (6040h)."""
        before, self._controlword = self._controlword, controlword
        if self.state is DriveState.FAULT:
            if fault_reset(before, controlword) and not self.emergency_stop and not self.disturbance.limit_switch:
                self.state = DriveState.SWITCH_ON_DISABLED
                self.errors.clear()
        else:
            self._obey(command_of(controlword))
            if self.state is DriveState.OPERATION_ENABLED and self._after is None:
                self._operate(before)
        self.publish()

    def fail(self, code: int) -> None:
        """Enter a fault and react as set in 605Eh; the axis ends in FAULT."""
        self.errors.enter(code)
        self._give_way()
        if self.state not in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            option = self._dictionary[0x605E, 0]
            if self.energised and option:
                self.state = DriveState.FAULT_REACTION_ACTIVE
                self._brake(fast=option != 1, then=DriveState.FAULT)
            else:
                self._release(DriveState.FAULT)
        self.publish()

    def lose_host(self) -> None:
        """React as set in the abort connection option 6007h. An axis without torque already stands."""
        self._give_way()
        match self._dictionary[0x6007, 0] if self.energised else 0:
            case 1:
                self.fail(FaultCode.HEARTBEAT)
            case 2:
                self.disable_voltage()
            case 3:
                self.quick_stop()
            case _:
                pass

    def quick_stop(self) -> None:
        """Quick stop of an enabled axis as set in 605Ah; other states do not change."""
        if self.state is DriveState.OPERATION_ENABLED:
            self._obey(Command.QUICK_STOP)
            self.publish()

    def disable_voltage(self) -> None:
        if self.state is not DriveState.FAULT:
            self._obey(Command.DISABLE_VOLTAGE)
            self.publish()

    def stop_safely(self, *, on: bool) -> None:
        """Safe torque off: immediate loss of torque, FAULT; no reset until it is released."""
        self.emergency_stop = on
        if on:
            self.errors.enter(FaultCode.EMERGENCY_STOP)
            self._give_way()
            self._release(DriveState.FAULT)
        self.publish()

    def hit_limit_switch(self, *, on: bool) -> None:
        """Hardware limit switch: a fault, and no reset until it is free again."""
        self.disturbance.limit_switch = on
        if on:
            self.fail(FaultCode.LIMIT_SWITCH)

    def _obey(self, command: Command | None) -> None:
        to = None if command is None else TRANSITIONS.get(self.state, {}).get(command)
        if to is None:
            return
        d, enabled = self._dictionary, self.state is DriveState.OPERATION_ENABLED
        if to is DriveState.OPERATION_ENABLED:
            self._enable()
        elif command is Command.QUICK_STOP and enabled:
            option = d[0x605A, 0]
            if option == 0:
                self._release(DriveState.SWITCH_ON_DISABLED)
            else:
                self.state = DriveState.QUICK_STOP_ACTIVE
                self._brake(fast=option not in (1, 5), then=None if option > 4 else DriveState.SWITCH_ON_DISABLED)
        elif command in (Command.SHUTDOWN, Command.SWITCH_ON) and enabled:
            if not d[0x605B if command is Command.SHUTDOWN else 0x605C, 0]:
                self._release(to)
            elif self._after is None:
                self._brake(fast=False, then=to)
        else:
            self._release(to)

    def _enable(self) -> None:
        again = self.state is DriveState.QUICK_STOP_ACTIVE
        if not self._can_move:
            self.fail(FaultCode.NO_POWER_SECTION)
        elif not again or (self._after is None and not self.braking):
            self.state = DriveState.OPERATION_ENABLED
            self._begin(again=again)

    def _brake(self, *, fast: bool, then: DriveState | None) -> None:
        """Ramp to standstill, then `then` (None: stay in this state and hold)."""
        self._after = then
        self._ramp_down(fast=fast)

    def _release(self, to: DriveState) -> None:
        """Torque off, brake closed: the axis stands."""
        self.state = to
        self._after = None
        self.speed = 0.0
        self._stand()

    # What a maker's axis adds

    @property
    def braking(self) -> bool:
        """Whether a ramp to standstill runs."""
        raise NotImplementedError

    def publish(self) -> None:
        """Set statusword, mode and actual values; call after any change of them."""
        raise NotImplementedError

    def _power_on(self) -> None:
        raise NotImplementedError

    def _begin(self, *, again: bool) -> None:
        """Start the mode from standstill; `again`: after a quick stop (transition 16)."""
        raise NotImplementedError

    def _operate(self, before: int) -> None:
        """Process the bits of the controlword that belong to the mode; `before`: the last controlword."""
        raise NotImplementedError

    def _ramp_down(self, *, fast: bool) -> None:
        raise NotImplementedError

    def _stand(self) -> None:
        raise NotImplementedError

    def _give_way(self) -> None:
        """A fault or a lost host: what a host had set for its measurement ends."""
