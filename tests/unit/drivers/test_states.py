"""The CiA 402 table, exhaustively."""

from typing import NamedTuple

import pytest

from drivers.cia402.states import ENERGISED, PATTERNS, STEPS, State, Wish, decode, operator_view, step
from drivers.errors import NotReady
from drivers.ports import AxisState


class Row(NamedTuple):
    """Of a state: a usual statusword, its view, whether it has energy; controlwords towards a wish, None: refused."""

    statusword: int
    view: AxisState
    energised: bool = False
    enabled: int | None = None
    fault_reset: int | None = None
    quick_stop: int = 0x02
    disabled: int = 0x00


TABLE = {
    State.NOT_READY: Row(0x0000, AxisState.DISABLED),
    State.SWITCH_ON_DISABLED: Row(0x0250, AxisState.DISABLED, enabled=0x06),
    State.READY: Row(0x0231, AxisState.DISABLED, enabled=0x07),
    State.SWITCHED_ON: Row(0x0233, AxisState.DISABLED, energised=True, enabled=0x0F),
    State.OPERATION_ENABLED: Row(0x0637, AxisState.ENABLED, energised=True, enabled=0x0F),
    State.QUICK_STOP_ACTIVE: Row(0x0217, AxisState.STOPPING, energised=True),
    State.FAULT_REACTION: Row(0x021F, AxisState.STOPPING, energised=True),
    State.FAULT: Row(0x0218, AxisState.FAULT, fault_reset=0x80),
    State.UNKNOWN: Row(0x0001, AxisState.UNKNOWN),
}


@pytest.mark.parametrize("state", State)
def test_each_state_and_what_may_be_said_in_it(state: State) -> None:
    row = TABLE[state]
    assert decode(row.statusword) is state
    assert operator_view(state) is row.view
    assert (state in ENERGISED) is row.energised
    for wish in Wish:
        word = getattr(row, wish.name.lower())
        assert STEPS.get((state, wish)) == word
        if word is None:
            with pytest.raises(NotReady, match=state.value):
                step(state, wish)
        else:
            assert step(state, wish) == word


def test_every_statusword_has_one_state_or_none() -> None:
    unknown = 0
    for statusword in range(0x10000):
        fitting = [state for mask, value, state in PATTERNS if statusword & mask == value]
        assert len(fitting) <= 1
        assert decode(statusword) is (fitting[0] if fitting else State.UNKNOWN)
        unknown += not fitting
    assert 0 < unknown < 0x10000
