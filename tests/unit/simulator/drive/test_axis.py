"""States by CiA 402-2, modes, stops and supervision of an axis whose motor follows exactly; its profiles."""

import struct

import numpy as np
import pytest
from hypothesis import given, strategies as st

from simulator.drive.limits import INCREMENTS
from simulator.drive.power_drive import ENERGISED, Command, DriveState, FaultCode
from simulator.waveform import brake, travel
from tests.unit.simulator.conftest import Rig

S = DriveState


def test_positioning_and_its_handshake(rig: Rig) -> None:
    rig.enable(1)
    rig.move(3.0)
    assert rig.held(0x6041) & 0x1400 == 0x1000  # acknowledged, not there
    rig.control(0x0F)
    assert rig.held(0x6041) & 0x1000 == 0
    speeds = rig.turn(4000)
    assert rig.axis.position == pytest.approx(3.0, abs=1e-3)
    assert rig.held(0x6041) & 0x400
    assert not rig.axis.moving
    assert speeds.max() <= 10.0  # 6081h
    assert np.abs(np.diff(speeds)).max() <= 1e6 / 60_000 * 0.001 + 1e-3  # 6083h, 6084h and the position controller
    rig.control(0x5F)  # relative: 3 more
    rig.turn(4000)
    assert rig.axis.position == pytest.approx(6.0, abs=1e-3)


def test_halt_stops_and_keeps_the_axis_enabled(rig: Rig) -> None:
    rig.enable(1)
    rig.move(50.0)
    rig.turn(400)
    rig.control(0x11F)
    rig.turn(2000)
    assert rig.state is S.OPERATION_ENABLED
    assert rig.turn(80) == pytest.approx(np.zeros(80), abs=1e-9)
    assert rig.axis.position < 40


@pytest.mark.parametrize(
    ("option", "seconds", "end"),
    [
        (0, 0.0, S.SWITCH_ON_DISABLED),
        (1, 0.6, S.SWITCH_ON_DISABLED),
        (2, 0.12, S.SWITCH_ON_DISABLED),
        (5, 0.6, S.QUICK_STOP_ACTIVE),
        (6, 0.12, S.QUICK_STOP_ACTIVE),
    ],
)
def test_quick_stop_by_its_option(rig: Rig, option: int, seconds: float, end: DriveState) -> None:
    rig.dictionary[0x605A, 0] = option
    rig.enable(1)
    rig.move(90.0)
    rig.turn(1000)
    assert rig.axis.speed == pytest.approx(10.0, rel=1e-3)
    rig.control(0x02)
    if seconds:
        assert rig.state is S.QUICK_STOP_ACTIVE
        speeds = rig.turn(round(seconds * 1000) - 8, 4)
        assert rig.axis.energised
        assert np.all(np.diff(speeds) < 0)
        rig.turn(24, 4)
    assert rig.state is end
    assert rig.turn(80) == pytest.approx(np.zeros(80))
    if end is S.QUICK_STOP_ACTIVE:
        assert rig.held(0x6041) & 0x400
        rig.control(0x0F)
        assert rig.state is S.OPERATION_ENABLED


@pytest.mark.parametrize(("controlword", "end"), [(0x06, S.READY_TO_SWITCH_ON), (0x07, S.SWITCHED_ON)])
def test_shutdown_and_disable_operation_ramp_first(rig: Rig, controlword: int, end: DriveState) -> None:
    rig.enable(1)
    rig.move(90.0)
    rig.turn(1000)
    rig.control(controlword)
    rig.turn(400)
    assert rig.state is S.OPERATION_ENABLED
    rig.turn(400)
    assert rig.state is end
    assert not rig.axis.energised


def test_missing_syncs_and_set_points_are_faults(rig: Rig) -> None:
    rig.enable(9)
    rig.axis.watch(100.0)
    assert rig.state is S.OPERATION_ENABLED  # no SYNC yet: nothing to monitor
    rig.stream(1.0, 100.0)
    rig.turn(4, 4)
    rig.axis.watch(100.09)
    assert rig.state is S.OPERATION_ENABLED
    rig.axis.watch(100.11)
    assert rig.state is S.FAULT_REACTION_ACTIVE
    assert rig.held(0x603F) == FaultCode.SYNC_MISSING
    rig.turn(100, 4)
    assert rig.state is S.FAULT

    rig.control(0x80)
    rig.enable(9)
    rig.stream(1.0, 200.0)
    for cycle in range(10):
        rig.axis.sync(200.0 + 0.004 * cycle)
    assert rig.state is S.OPERATION_ENABLED
    rig.axis.sync(200.1)
    assert rig.held(0x603F) == FaultCode.SET_POINT_MISSING


def test_mode_9_needs_its_interpolation_period_and_a_fresh_set_point(rig: Rig) -> None:
    rig.dictionary.download(0x60FF, 0, struct.pack("<i", 60_000))
    rig.enable(9)
    rig.axis.sync(0.0)
    assert rig.turn(4, 4) == pytest.approx(np.zeros(4))  # none survives enabling
    rig.axis.reset()
    rig.dictionary[0x1006, 0] = 10_000
    rig.enable(9)
    assert rig.held(0x603F) == FaultCode.PARAMETER


def test_limits_are_kept_in_the_drive(rig: Rig) -> None:
    rig.enable(1)
    rig.move(100.5)
    assert rig.held(0x603F) == FaultCode.POSITION_LIMIT
    assert rig.state is S.FAULT_REACTION_ACTIVE
    rig.turn(16)
    assert rig.state is S.FAULT

    rig.control(0x80)
    rig.enable(9)
    rig.stream(50.1, 0.0)
    assert rig.held(0x603F) == FaultCode.SPEED_LIMIT
    rig.turn(16)

    rig.control(0x00, 0x80)
    rig.dictionary[0x607D, 2] = round(0.5 * INCREMENTS)
    rig.enable(9)
    for cycle in range(500):
        rig.stream(2.0, 0.004 * cycle)
        rig.turn(4, 4)
    assert rig.held(0x603F) == FaultCode.POSITION_LIMIT
    assert rig.state is S.FAULT
    assert 0.45 < rig.axis.position < 0.51


def test_staying_at_the_torque_limit_is_a_fault(rig: Rig) -> None:
    rig.dictionary[0x60E1, 0] = 250
    assert rig.axis.torque_limit == 0.25
    rig.enable(1)
    rig.turn(96, torque=5.0, limited=True)
    assert rig.held(0x6077) == 250
    assert rig.held(0x6041) & 0x800
    rig.turn(16, torque=5.0, limited=True)
    assert rig.held(0x603F) == FaultCode.TORQUE_LIMIT


@pytest.mark.parametrize("state", list(DriveState))
@pytest.mark.parametrize("rotating", [False, True])
def test_safe_torque_off_in_every_state(rig: Rig, state: DriveState, rotating: bool) -> None:
    if rotating:
        rig.enable(1)
        rig.move(90.0)
        rig.turn(400)
    rig.axis.state = state
    rig.axis.stop_safely(on=True)
    assert (rig.state, rig.axis.energised, rig.axis.moving) == (S.FAULT, False, False)
    assert rig.held(0x6041) & 0x5F == 0x08  # FAULT, no voltage
    assert rig.held(0x603F) == FaultCode.EMERGENCY_STOP
    for controlword in (0x80, 0x00, 0x80, 0x06, 0x07, 0x0F, 0x1F):
        rig.control(controlword)
        assert rig.state is S.FAULT
        assert rig.turn(16) == pytest.approx(np.zeros(16))
    rig.axis.reset()
    assert (rig.state, rig.held(0x2130, 1)) == (S.FAULT, 1)
    rig.axis.stop_safely(on=False)
    assert rig.state is S.FAULT
    rig.control(0x00, 0x80)
    assert rig.state is S.SWITCH_ON_DISABLED


def test_errors_are_told_and_remembered(rig: Rig) -> None:
    rig.axis.fail(0x7305)
    rig.axis.fail(0x2310)
    told = [struct.pack("<HB5x", *error) for error in ((0x7305, 0x21), (0x2310, 0x23))]
    assert rig.axis.errors.take_messages() == told
    rig.control(0x80)
    assert rig.axis.errors.take_messages() == [bytes(8)]
    assert rig.held(0x1001) == 0
    assert [rig.held(0x1003, sub) for sub in range(4)] == [2, 0x2310, 0x7305, 0]
    rig.dictionary.download(0x1003, 0, b"\0")
    assert [rig.held(0x1003, sub) for sub in range(4)] == [0, 0, 0, 0]


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
def test_every_controlword_in_every_state(rig: Rig, state: DriveState) -> None:
    for index in (0x605B, 0x605C, 0x605E):
        rig.dictionary[index, 0] = 0  # no ramps: the state follows at once
    rig.dictionary[0x605A, 0] = 6  # stay in QUICK STOP ACTIVE
    expected = {(start, command): end for start, command, end in NUMBERED.values()}
    for controlword in (*range(0x100), *range(0xFF00, 0x10000)):
        rig.axis.reset()
        rig.axis.state = state
        rig.control(controlword)
        end = state
        if controlword & 0x80:
            end = S.SWITCH_ON_DISABLED if state is S.FAULT else state  # transition 15
        elif state is not S.FAULT:
            end = expected.get((state, BY_BITS[controlword & 0x0F]), state)
        assert rig.state is end, f"{state.name} {controlword:02x}h"
        assert rig.axis.energised == (end in ENERGISED)


def test_a_fault_is_reset_by_the_rising_edge_only(rig: Rig) -> None:
    rig.control(0x80)
    rig.axis.fail(0x7305)
    for controlword, state in ((0x8F, S.FAULT), (0x0F, S.FAULT), (0x8F, S.SWITCH_ON_DISABLED)):
        rig.control(controlword)
        assert rig.state is state
    rig.control(0x8F)
    assert rig.state is S.SWITCH_ON_DISABLED
