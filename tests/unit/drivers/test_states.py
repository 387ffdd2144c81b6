"""The CiA 402 table, exhaustively."""

import pytest

from drivers.cia402.states import (
    ENERGISED,
    PATTERNS,
    QUICK_STOP,
    STEPS,
    State,
    Wish,
    decode,
    operator_view,
    step,
)
from drivers.errors import NotReady
from drivers.ports import AxisState

ENABLE_BITS = 0x0F
FAULT_RESET_BIT = 0x80


def test_every_statusword_has_one_state_or_none() -> None:
    unknown = 0
    for statusword in range(0x10000):
        fitting = [state for mask, value, state in PATTERNS if statusword & mask == value]
        assert len(fitting) <= 1
        assert decode(statusword) is (fitting[0] if fitting else State.UNKNOWN)
        unknown += not fitting
    assert 0 < unknown < 0x10000


@pytest.mark.parametrize(
    ("statusword", "state"),
    [
        (0x0000, State.NOT_READY),
        (0x0250, State.SWITCH_ON_DISABLED),
        (0x0231, State.READY),
        (0x0233, State.SWITCHED_ON),
        (0x0637, State.OPERATION_ENABLED),
        (0x0217, State.QUICK_STOP_ACTIVE),
        (0x021F, State.FAULT_REACTION),
        (0x0218, State.FAULT),
        (0x0001, State.UNKNOWN),
    ],
)
def test_typical_statuswords(statusword: int, state: State) -> None:
    assert decode(statusword) is state


def test_enabling_is_one_path_and_never_from_a_fault_or_the_unknown() -> None:
    path = [State.SWITCH_ON_DISABLED, State.READY, State.SWITCHED_ON, State.OPERATION_ENABLED]
    assert [step(state, Wish.ENABLED) for state in path] == [0x06, 0x07, 0x0F, 0x0F]
    for state in set(State) - set(path):
        with pytest.raises(NotReady, match=state.value):
            step(state, Wish.ENABLED)


def test_no_word_but_enabling_can_close_the_loop() -> None:
    for (_, wish), controlword in STEPS.items():
        if wish is not Wish.ENABLED:
            assert controlword & ENABLE_BITS in (0x00, QUICK_STOP)


def test_stopping_and_disabling_are_allowed_from_everywhere() -> None:
    for state in State:
        assert step(state, Wish.QUICK_STOP) == 0x02
        assert step(state, Wish.DISABLED) == 0x00


def test_fault_reset_is_bit_7_alone_and_only_out_of_a_fault() -> None:
    assert step(State.FAULT, Wish.FAULT_RESET) == FAULT_RESET_BIT
    for state in set(State) - {State.FAULT}:
        with pytest.raises(NotReady):
            step(state, Wish.FAULT_RESET)
    assert [key for key, word in STEPS.items() if word & FAULT_RESET_BIT] == [(State.FAULT, Wish.FAULT_RESET)]


def test_every_state_means_something_to_the_operator() -> None:
    assert {state for state in State if operator_view(state) is AxisState.ENABLED} == {State.OPERATION_ENABLED}
    assert operator_view(State.UNKNOWN) is AxisState.UNKNOWN
    assert State.SWITCH_ON_DISABLED not in ENERGISED
    assert State.FAULT not in ENERGISED
