"""Every state against every controlword, as CiA 402-2 numbers the transitions."""

import pytest

from simulator.drive.axis import Axis
from simulator.drive.dictionary import Dictionary
from simulator.drive.states import ENERGISED, Command, State

S = State
BY_BITS = {  # bits 3..0 of the controlword with bit 7 = 0 -> command, from the standard's table
    **dict.fromkeys((0, 1, 4, 5, 8, 9, 12, 13), Command.DISABLE_VOLTAGE),
    **dict.fromkeys((2, 3, 10, 11), Command.QUICK_STOP),
    **dict.fromkeys((6, 14), Command.SHUTDOWN),
    0x7: Command.SWITCH_ON,
    0xF: Command.ENABLE_OPERATION,
}
NUMBERED = {
    2: (S.SWITCH_ON_DISABLED, Command.SHUTDOWN, S.READY_TO_SWITCH_ON),
    3: (S.READY_TO_SWITCH_ON, Command.SWITCH_ON, S.SWITCHED_ON),
    "3+4": (S.READY_TO_SWITCH_ON, Command.ENABLE_OPERATION, S.OPERATION_ENABLED),
    4: (S.SWITCHED_ON, Command.ENABLE_OPERATION, S.OPERATION_ENABLED),
    5: (S.OPERATION_ENABLED, Command.SWITCH_ON, S.SWITCHED_ON),
    6: (S.SWITCHED_ON, Command.SHUTDOWN, S.READY_TO_SWITCH_ON),
    "7v": (S.READY_TO_SWITCH_ON, Command.DISABLE_VOLTAGE, S.SWITCH_ON_DISABLED),
    "7q": (S.READY_TO_SWITCH_ON, Command.QUICK_STOP, S.SWITCH_ON_DISABLED),
    8: (S.OPERATION_ENABLED, Command.SHUTDOWN, S.READY_TO_SWITCH_ON),
    9: (S.OPERATION_ENABLED, Command.DISABLE_VOLTAGE, S.SWITCH_ON_DISABLED),
    "10v": (S.SWITCHED_ON, Command.DISABLE_VOLTAGE, S.SWITCH_ON_DISABLED),
    "10q": (S.SWITCHED_ON, Command.QUICK_STOP, S.SWITCH_ON_DISABLED),
    11: (S.OPERATION_ENABLED, Command.QUICK_STOP, S.QUICK_STOP_ACTIVE),
    12: (S.QUICK_STOP_ACTIVE, Command.DISABLE_VOLTAGE, S.SWITCH_ON_DISABLED),
    16: (S.QUICK_STOP_ACTIVE, Command.ENABLE_OPERATION, S.OPERATION_ENABLED),
}


@pytest.mark.parametrize("state", list(State))
def test_every_controlword_in_every_state(dictionary: Dictionary, axis: Axis, state: State) -> None:
    for index in (0x605B, 0x605C, 0x605E):
        dictionary[index, 0] = 0  # no ramps: the state follows at once
    dictionary[0x605A, 0] = 6  # stay in QUICK STOP ACTIVE
    expected = {(start, command): end for start, command, end in NUMBERED.values()}
    for controlword in (*range(0x100), *range(0xFF00, 0x10000)):
        axis.reset()
        axis.state = state
        axis.control(controlword)
        end = state
        if controlword & 0x80:
            end = S.SWITCH_ON_DISABLED if state is S.FAULT else state  # transition 15
        elif state is not S.FAULT:
            end = expected.get((state, BY_BITS[controlword & 0x0F]), state)
        assert axis.state is end, f"{state.name} {controlword:02x}h"
        assert axis.energised == (end in ENERGISED)


def test_a_fault_is_reset_by_the_rising_edge_only(axis: Axis) -> None:
    axis.control(0x80)
    axis.fail(0x7305)
    axis.control(0x8F)
    assert axis.state is State.FAULT
    axis.control(0x0F)
    assert axis.state is State.FAULT
    axis.control(0x8F)
    assert axis.state is State.SWITCH_ON_DISABLED
    axis.control(0x8F)
    assert axis.state is State.SWITCH_ON_DISABLED


@pytest.mark.parametrize(
    ("state", "mask", "code"),
    [
        (State.NOT_READY_TO_SWITCH_ON, 0x4F, 0x00),
        (State.SWITCH_ON_DISABLED, 0x4F, 0x40),
        (State.READY_TO_SWITCH_ON, 0x6F, 0x21),
        (State.SWITCHED_ON, 0x6F, 0x23),
        (State.OPERATION_ENABLED, 0x6F, 0x27),
        (State.QUICK_STOP_ACTIVE, 0x6F, 0x07),
        (State.FAULT_REACTION_ACTIVE, 0x4F, 0x0F),
        (State.FAULT, 0x4F, 0x08),
    ],
)
def test_the_statusword_of_every_state(dictionary: Dictionary, axis: Axis, state: State, mask: int, code: int) -> None:
    axis.state = state
    axis.control(0x80)
    if state is not State.FAULT:  # that was a reset
        assert dictionary[0x6041, 0] & mask == code
