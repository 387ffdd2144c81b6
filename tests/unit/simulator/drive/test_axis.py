"""States by CiA 402-2, modes, stops and supervision of an axis whose motor follows exactly; its profiles."""

import struct
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, strategies as st

from simulator.drive.dictionary import ObjectDictionary
from simulator.drive.power_drive import ENERGISED, Command, DriveState, FaultCode
from simulator.drive.virtual_axis import VirtualAxis
from simulator.waveform import brake, travel

REV = 1 << 20
Turn = Callable[..., np.ndarray]
Enable = Callable[[int], None]


def target(dictionary: ObjectDictionary, axis: VirtualAxis, revolutions: float) -> None:
    dictionary[0x607A, 0] = round(revolutions * REV)
    axis.control(0x0F)
    axis.control(0x1F)


def stream(dictionary: ObjectDictionary, axis: VirtualAxis, speed: float, now: float) -> None:
    """A set-point in rev/s and the SYNC after it."""
    dictionary.download(0x60FF, 0, struct.pack("<i", round(speed * 60_000)))
    axis.sync(now)


def test_positioning_and_its_handshake(
    dictionary: ObjectDictionary, axis: VirtualAxis, turn: Turn, enable: Enable
) -> None:
    enable(1)
    target(dictionary, axis, 3.0)
    assert dictionary[0x6041, 0] & 0x1400 == 0x1000  # acknowledged, not there
    axis.control(0x0F)
    assert dictionary[0x6041, 0] & 0x1000 == 0
    speeds = turn(4000)
    assert axis.position == pytest.approx(3.0, abs=1e-3)
    assert dictionary[0x6041, 0] & 0x400
    assert not axis.moving
    assert speeds.max() <= 10.0  # 6081h
    assert np.abs(np.diff(speeds)).max() <= 1e6 / 60_000 * 0.001 + 1e-3  # 6083h, 6084h and the position controller

    axis.control(0x5F)  # relative: 3 more
    turn(4000)
    assert axis.position == pytest.approx(6.0, abs=1e-3)


def test_halt_stops_and_keeps_the_axis_enabled(
    dictionary: ObjectDictionary, axis: VirtualAxis, turn: Turn, enable: Enable
) -> None:
    enable(1)
    target(dictionary, axis, 50.0)
    turn(400)
    axis.control(0x11F)
    turn(2000)
    assert axis.state is DriveState.OPERATION_ENABLED
    assert turn(80) == pytest.approx(np.zeros(80), abs=1e-9)
    assert axis.position < 40


@pytest.mark.parametrize(
    ("option", "seconds", "end"),
    [
        (0, 0.0, DriveState.SWITCH_ON_DISABLED),
        (1, 0.6, DriveState.SWITCH_ON_DISABLED),
        (2, 0.12, DriveState.SWITCH_ON_DISABLED),
        (5, 0.6, DriveState.QUICK_STOP_ACTIVE),
        (6, 0.12, DriveState.QUICK_STOP_ACTIVE),
    ],
)
def test_quick_stop_by_its_option(
    dictionary: ObjectDictionary,
    axis: VirtualAxis,
    turn: Turn,
    enable: Enable,
    option: int,
    seconds: float,
    end: DriveState,
) -> None:
    dictionary[0x605A, 0] = option
    enable(1)
    target(dictionary, axis, 90.0)
    turn(1000)
    assert axis.speed == pytest.approx(10.0, rel=1e-3)
    axis.control(0x02)
    if seconds:
        assert axis.state is DriveState.QUICK_STOP_ACTIVE
        speeds = turn(round(seconds * 1000) - 8, 4)
        assert axis.energised
        assert np.all(np.diff(speeds) < 0)
        turn(24, 4)
    assert axis.state is end
    assert turn(80) == pytest.approx(np.zeros(80))
    if end is DriveState.QUICK_STOP_ACTIVE:
        assert dictionary[0x6041, 0] & 0x400
        axis.control(0x0F)
        assert axis.state is DriveState.OPERATION_ENABLED


@pytest.mark.parametrize(
    ("controlword", "end"), [(0x06, DriveState.READY_TO_SWITCH_ON), (0x07, DriveState.SWITCHED_ON)]
)
def test_shutdown_and_disable_operation_ramp_first(
    dictionary: ObjectDictionary, axis: VirtualAxis, turn: Turn, enable: Enable, controlword: int, end: DriveState
) -> None:
    enable(1)
    target(dictionary, axis, 90.0)
    turn(1000)
    axis.control(controlword)
    turn(400)
    assert axis.state is DriveState.OPERATION_ENABLED
    turn(400)
    assert axis.state is end
    assert not axis.energised


def test_missing_syncs_and_set_points_are_faults(
    dictionary: ObjectDictionary, axis: VirtualAxis, turn: Turn, enable: Enable
) -> None:
    enable(9)
    axis.watch(100.0)
    assert axis.state is DriveState.OPERATION_ENABLED  # no SYNC yet: nothing to monitor
    stream(dictionary, axis, 1.0, 100.0)
    turn(4, 4)
    axis.watch(100.09)
    assert axis.state is DriveState.OPERATION_ENABLED
    axis.watch(100.11)
    assert axis.state is DriveState.FAULT_REACTION_ACTIVE
    assert dictionary[0x603F, 0] == FaultCode.SYNC_MISSING
    turn(100, 4)
    assert axis.state is DriveState.FAULT

    axis.control(0x80)
    enable(9)
    stream(dictionary, axis, 1.0, 200.0)
    for cycle in range(10):
        axis.sync(200.0 + 0.004 * cycle)
    assert axis.state is DriveState.OPERATION_ENABLED
    axis.sync(200.1)
    assert dictionary[0x603F, 0] == FaultCode.SET_POINT_MISSING


def test_mode_9_needs_its_interpolation_period(dictionary: ObjectDictionary, axis: VirtualAxis, enable: Enable) -> None:
    dictionary[0x1006, 0] = 10_000
    enable(9)
    assert dictionary[0x603F, 0] == FaultCode.PARAMETER


def test_no_set_point_survives_enabling(
    dictionary: ObjectDictionary, axis: VirtualAxis, turn: Turn, enable: Enable
) -> None:
    dictionary.download(0x60FF, 0, struct.pack("<i", 60_000))
    enable(9)
    axis.sync(0.0)
    assert turn(4, 4) == pytest.approx(np.zeros(4))


def test_limits_are_kept_in_the_drive(
    dictionary: ObjectDictionary, axis: VirtualAxis, turn: Turn, enable: Enable
) -> None:
    enable(1)
    target(dictionary, axis, 100.5)
    assert dictionary[0x603F, 0] == FaultCode.POSITION_LIMIT
    assert axis.state is DriveState.FAULT_REACTION_ACTIVE
    turn(16)
    assert axis.state is DriveState.FAULT

    axis.control(0x80)
    enable(9)
    stream(dictionary, axis, 50.1, 0.0)
    assert dictionary[0x603F, 0] == FaultCode.SPEED_LIMIT
    turn(16)

    axis.control(0x00)
    axis.control(0x80)
    dictionary[0x607D, 2] = round(0.5 * REV)
    enable(9)
    for cycle in range(500):
        stream(dictionary, axis, 2.0, 0.004 * cycle)
        turn(4, 4)
    assert dictionary[0x603F, 0] == FaultCode.POSITION_LIMIT
    assert axis.state is DriveState.FAULT
    assert 0.45 < axis.position < 0.51


def test_staying_at_the_torque_limit_is_a_fault(
    dictionary: ObjectDictionary, axis: VirtualAxis, turn: Turn, enable: Enable
) -> None:
    dictionary[0x60E1, 0] = 250
    assert axis.torque_limit == 0.25
    enable(1)
    turn(96, torque=5.0, limited=True)
    assert dictionary[0x6077, 0] == 250
    assert dictionary[0x6041, 0] & 0x800
    turn(16, torque=5.0, limited=True)
    assert dictionary[0x603F, 0] == FaultCode.TORQUE_LIMIT


@pytest.mark.parametrize("state", list(DriveState))
@pytest.mark.parametrize("rotating", [False, True])
def test_safe_torque_off_in_every_state(
    dictionary: ObjectDictionary, axis: VirtualAxis, turn: Turn, enable: Enable, state: DriveState, rotating: bool
) -> None:
    if rotating:
        enable(1)
        target(dictionary, axis, 90.0)
        turn(400)
    axis.state = state
    axis.stop_safely(on=True)
    assert (axis.state, axis.energised, axis.moving) == (DriveState.FAULT, False, False)
    assert dictionary[0x6041, 0] & 0x5F == 0x08  # FAULT, no voltage
    assert dictionary[0x603F, 0] == FaultCode.EMERGENCY_STOP
    for controlword in (0x80, 0x00, 0x80, 0x06, 0x07, 0x0F, 0x1F):
        axis.control(controlword)
        assert axis.state is DriveState.FAULT
        assert turn(16) == pytest.approx(np.zeros(16))
    axis.reset()
    assert (axis.state, dictionary[0x2130, 1]) == (DriveState.FAULT, 1)
    axis.stop_safely(on=False)
    assert axis.state is DriveState.FAULT
    axis.control(0x00)
    axis.control(0x80)
    assert axis.state is DriveState.SWITCH_ON_DISABLED


def test_errors_are_told_and_remembered(dictionary: ObjectDictionary, axis: VirtualAxis) -> None:
    axis.fail(0x7305)
    axis.fail(0x2310)
    assert axis.errors.take_messages() == [struct.pack("<HB5x", 0x7305, 0x21), struct.pack("<HB5x", 0x2310, 0x23)]
    axis.control(0x80)
    assert axis.errors.take_messages() == [bytes(8)]
    assert dictionary[0x1001, 0] == 0
    assert [dictionary[0x1003, sub] for sub in range(4)] == [2, 0x2310, 0x7305, 0]
    dictionary.download(0x1003, 0, b"\0")
    assert [dictionary[0x1003, sub] for sub in range(4)] == [0, 0, 0, 0]


speed = st.floats(0.1, 50)


def test_a_triangle_and_no_way_at_all() -> None:
    assert travel(-2.0, 0.0, 50.0, 2.0, 2.0).velocities == pytest.approx((0, -2, -2, 0))
    assert travel(0.0, 0.0, 1.0, 1.0, 1.0).duration == 0.0
    assert travel(5e-324, 0.0, 1.0, 0.5, 0.5).duration == 0.0  # the square of its speed underflows
    assert brake(0.0, 1.0).duration == 0.0
    assert brake(-3.0, 2.0).distance == pytest.approx(-2.25)


@given(st.floats(-100, 100), st.floats(-60, 60), speed, speed, speed)
def test_arrives_within_its_limits(distance: float, start: float, limit: float, up: float, down: float) -> None:
    motion = travel(distance, start, limit, up, down)
    assert motion.distance == pytest.approx(distance, abs=1e-6)
    assert motion.velocities[0] == pytest.approx(start) or motion.duration == 0.0
    assert motion.velocities[-1] == 0.0
    assert max(map(abs, motion.velocities)) <= max(limit, abs(start)) * (1 + 1e-9)
    steps = np.abs(np.diff(motion.velocities))
    assert np.all(steps <= np.array(motion.durations) * max(up, down) * (1 + 1e-6) + 1e-9)


S = DriveState
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


@pytest.mark.parametrize("state", list(DriveState))
def test_every_controlword_in_every_state(dictionary: ObjectDictionary, axis: VirtualAxis, state: DriveState) -> None:
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


def test_a_fault_is_reset_by_the_rising_edge_only(axis: VirtualAxis) -> None:
    axis.control(0x80)
    axis.fail(0x7305)
    axis.control(0x8F)
    assert axis.state is DriveState.FAULT
    axis.control(0x0F)
    assert axis.state is DriveState.FAULT
    axis.control(0x8F)
    assert axis.state is DriveState.SWITCH_ON_DISABLED
    axis.control(0x8F)
    assert axis.state is DriveState.SWITCH_ON_DISABLED
