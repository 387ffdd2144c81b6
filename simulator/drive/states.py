"""The power drive system's finite state automaton (CiA 402-2, figure 1) as tables, and the modes of operation."""

from enum import Enum, IntEnum


class State(IntEnum):
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
    """Modes of operation, 6060h."""

    NONE = 0
    PROFILE_POSITION = 1
    CYCLIC_VELOCITY = 9


class Command(Enum):
    """Commands in a controlword. (mask, value); checked in this order."""

    DISABLE_VOLTAGE = (0x82, 0x00)
    QUICK_STOP = (0x86, 0x02)
    SHUTDOWN = (0x87, 0x06)
    SWITCH_ON = (0x8F, 0x07)  # in OPERATION ENABLED: disable operation
    ENABLE_OPERATION = (0x8F, 0x0F)


ENERGISED = frozenset({State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE})
"""States with torque on and brake open."""

TRANSITIONS: dict[State, dict[Command, State]] = {
    State.SWITCH_ON_DISABLED: {Command.SHUTDOWN: State.READY_TO_SWITCH_ON},
    State.READY_TO_SWITCH_ON: {
        Command.DISABLE_VOLTAGE: State.SWITCH_ON_DISABLED,
        Command.QUICK_STOP: State.SWITCH_ON_DISABLED,
        Command.SWITCH_ON: State.SWITCHED_ON,
        Command.ENABLE_OPERATION: State.OPERATION_ENABLED,  # transitions 3 and 4 together
    },
    State.SWITCHED_ON: {
        Command.DISABLE_VOLTAGE: State.SWITCH_ON_DISABLED,
        Command.QUICK_STOP: State.SWITCH_ON_DISABLED,
        Command.SHUTDOWN: State.READY_TO_SWITCH_ON,
        Command.ENABLE_OPERATION: State.OPERATION_ENABLED,
    },
    State.OPERATION_ENABLED: {
        Command.DISABLE_VOLTAGE: State.SWITCH_ON_DISABLED,
        Command.QUICK_STOP: State.QUICK_STOP_ACTIVE,
        Command.SHUTDOWN: State.READY_TO_SWITCH_ON,
        Command.SWITCH_ON: State.SWITCHED_ON,
    },
    State.QUICK_STOP_ACTIVE: {
        Command.DISABLE_VOLTAGE: State.SWITCH_ON_DISABLED,
        Command.ENABLE_OPERATION: State.OPERATION_ENABLED,  # transition 16, at standstill only
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
