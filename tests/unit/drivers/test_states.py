"""The CiA 402 table, exhaustively, and the stop sequence of a streaming axis."""

from typing import NamedTuple

import pytest
from hypothesis import given, strategies as st

from drivers.canopen.streamed_axis import StopSequence, StopStage
from drivers.cia402 import states
from drivers.cia402.states import ENERGISED, PATTERNS, STEPS, Controlword, PowerState, Wish, decode, operator_view, step
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
    PowerState.NOT_READY: Row(0x0000, AxisState.DISABLED),
    PowerState.SWITCH_ON_DISABLED: Row(0x0250, AxisState.DISABLED, enabled=0x06),
    PowerState.READY: Row(0x0231, AxisState.DISABLED, enabled=0x07),
    PowerState.SWITCHED_ON: Row(0x0233, AxisState.DISABLED, energised=True, enabled=0x0F),
    PowerState.OPERATION_ENABLED: Row(0x0637, AxisState.ENABLED, energised=True, enabled=0x0F),
    PowerState.QUICK_STOP_ACTIVE: Row(0x0217, AxisState.STOPPING, energised=True),
    PowerState.FAULT_REACTION: Row(0x021F, AxisState.STOPPING, energised=True),
    PowerState.FAULT: Row(0x0218, AxisState.FAULT, fault_reset=0x80),
    PowerState.UNKNOWN: Row(0x0001, AxisState.UNKNOWN),
}


@pytest.mark.parametrize("state", PowerState)
def test_each_state_and_what_may_be_said_in_it(state: PowerState) -> None:
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
        assert decode(statusword) is (fitting[0] if fitting else PowerState.UNKNOWN)
        unknown += not fitting
    assert 0 < unknown < 0x10000


ENABLED, OFF = PowerState.OPERATION_ENABLED, PowerState.SWITCH_ON_DISABLED


def stop_sequence() -> StopSequence:
    return StopSequence(ramp_step=10, ramp_time=1.0, quick_stop_time=1.0, disable_time=1.0)


RAMP, QUICK_STOP, DISABLE, DONE = StopStage.RAMP, StopStage.QUICK_STOP, StopStage.DISABLE, StopStage.DONE
# the first stage and set-point; then: time, whether it stands, its state; what it is told, and the stage after that
LADDERS = {
    **{
        f"from {sign * 25}": (
            (RAMP, sign * 25),
            *((0.1, False, ENABLED, (0x0F, sign * target), RAMP) for target in (15, 5, 0, 0)),
            (0.2, True, ENABLED, (0x00, 0), DISABLE),
            (0.3, True, OFF, (0x00, 0), DONE),
        )
        for sign in (1, -1)
    },
    "each stage gives way at its deadline": (
        (RAMP, 10**6),
        (0.9, False, ENABLED, (0x0F, 10**6 - 10), RAMP),
        (1.1, False, ENABLED, (0x02, 0), QUICK_STOP),
        (2.0, False, PowerState.QUICK_STOP_ACTIVE, (0x02, 0), QUICK_STOP),
        (2.2, False, PowerState.QUICK_STOP_ACTIVE, (0x00, 0), DISABLE),
        (3.3, False, PowerState.QUICK_STOP_ACTIVE, (0x00, 0), DONE),
    ),
    "a silent drive is told until the end": (
        (QUICK_STOP, 100),
        (0.5, False, PowerState.UNKNOWN, (0x02, 0), QUICK_STOP),
        (1.1, False, PowerState.UNKNOWN, (0x00, 0), DISABLE),
        (2.2, False, PowerState.UNKNOWN, (0x00, 0), DONE),
    ),
    "a fault ends it once the drive is off": (
        (QUICK_STOP, 100),
        (0.1, False, PowerState.FAULT_REACTION, (0x02, 0), QUICK_STOP),
        (0.2, False, PowerState.FAULT, (0x00, 0), DONE),
    ),
}


@pytest.mark.parametrize("case", LADDERS)
def test_rung_by_rung(case: str) -> None:
    (first, start), *steps = LADDERS[case]
    one = stop_sequence()
    one.advance(first, 0.0, start)
    for now, standing, state, command, stage in steps:
        assert (one.command(now, standing, state), one.stage) == (command, stage), now


BIT_3 = 0x08  # enable operation
Step = tuple[float, bool, int, StopStage | None]


@given(
    st.integers(-(2**31), 2**31 - 1),
    st.lists(
        st.tuples(
            st.floats(0.0, 2.0),
            st.booleans(),
            st.integers(0, 0xFFFF) | st.sampled_from([0x27, 0x23, 0x21, 0x40, 0x07, 0x08, 0x0F, 0x00]),
            st.none() | st.sampled_from(StopStage),
        ),
        max_size=60,
    ),
)
def test_whatever_happens_it_enables_no_drive_that_is_not_enabled_and_only_slows_down(
    start: int, steps: list[Step]
) -> None:
    """Any order of times, statuswords and calls to advance, from any set-point; the run itself is no stop sequence."""
    one, now, last, stage = stop_sequence(), 0.0, abs(start), StopStage.RUN
    for passed, standing, statusword, goal in steps:
        now += passed
        state = states.decode(statusword)
        if goal is not None:
            one.advance(goal, now, start)
        controlword, target = one.command(now, standing, state)
        assert not controlword & BIT_3 or state is ENABLED
        assert controlword in (Controlword.ENABLE_OPERATION, Controlword.QUICK_STOP, Controlword.DISABLE_VOLTAGE)
        assert abs(target) <= last
        assert one.stage >= max(stage, StopStage.RAMP)
        last, stage = abs(target), one.stage
        start = target
