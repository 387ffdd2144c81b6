"""A plain CiA 402 drive, walked and driven by the `canopen` package: states, modes, faults, heartbeats."""

import math

import numpy as np
import pytest

from tests.unit.simulator.foreign.master import ENABLE, PERIOD, QUICK_STOP, SHUT_DOWN, SWITCH_ON, Cycle, Master

INCREMENTS, GEAR, RATED = 131072, 171, 17.544  # a motor revolution, of joint 1, N m
JOINT = math.tau / GEAR / INCREMENTS  # rad (rad/s) of the joint in one increment (a second)
TARGET_VELOCITY, TARGET_POSITION = 0x60FF0000, 0x607A0000
CSV, PV, PP = 9, 3, 1
SPEED = 200_000  # increments a second


def turning(master: Master) -> Cycle:
    """In operation, on its way to `SPEED`."""
    cycle = master.enabled(CSV, TARGET_VELOCITY)
    cycle.run(ENABLE, SPEED, 50)
    return cycle


def test_the_package_walks_the_states(master: Master) -> None:
    node = master.node
    node.setup_402_state_machine()
    node.nmt.state = "OPERATIONAL"
    for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED", "SWITCHED ON", "READY TO SWITCH ON"):
        node.state = state
        assert node.state == state
        assert master.truth()["energised"] is (state == "OPERATION ENABLED")
    node.state = "OPERATION ENABLED"
    node.state = "SWITCH ON DISABLED"
    assert not master.truth()["energised"]


def test_set_points_are_interpolated_over_60c2(master: Master) -> None:
    """With 60C2h = 100 SYNC periods a step is a ramp over as many; in half of its way friction is overcome."""
    master.write(0x1006, 0, PERIOD * 1000, 4)
    cycle = Cycle(master, TARGET_VELOCITY)
    master.write(0x60C2, 2, -2, 1)
    master.write(0x60C2, 1, 10 * PERIOD, 1)
    master.write(0x6060, 0, CSV, 1)
    cycle.enable()
    cycle.run(ENABLE, 0, 2)
    speeds = [cycle.run(ENABLE, SPEED, 1)[1] for _ in range(150)]
    assert np.mean(speeds[70:80]) == pytest.approx(SPEED * 0.75, rel=0.1)
    assert np.mean(speeds[80:90]) == pytest.approx(SPEED * 0.85, rel=0.1)
    assert np.mean(speeds[140:]) == pytest.approx(SPEED, rel=0.05)


def test_the_profile_of_velocity_obeys_its_ramps(master: Master) -> None:
    cycle = Cycle(master, TARGET_VELOCITY)
    master.write(0x6060, 0, PV, 1)
    master.write(0x6083, 0, SPEED // 2, 4)
    cycle.enable()
    assert cycle.run(ENABLE, SPEED, 125)[1] == pytest.approx(SPEED / 2, rel=0.1)  # after 1 s
    word, velocity, *_ = cycle.run(ENABLE, SPEED, 200)
    assert velocity == pytest.approx(SPEED, rel=0.1)
    assert word & 0x0400
    cycle.run(ENABLE | 0x100, SPEED, 100)  # halt
    word, velocity, *_ = cycle.run(ENABLE | 0x100, SPEED, 1)
    assert abs(velocity) < 500
    assert word & 0x1000


def test_a_move_ends_at_the_position_limit(master: Master) -> None:
    cycle = Cycle(master, TARGET_POSITION)
    master.write(0x6060, 0, PP, 1)
    here = cycle.run(0, 0, 1)[3]
    master.write(0x607D, 2, here + INCREMENTS, 4)
    cycle.enable(here)
    cycle.run(ENABLE | 0x10, here + 5 * INCREMENTS, 2)
    master.settle(lambda: bool(cycle.run(ENABLE, 0, 1)[0] & 0x0400))
    word, _, _, position = cycle.run(ENABLE, 0, 1)
    assert word & 0x0800
    assert position == pytest.approx(here + INCREMENTS, abs=INCREMENTS / 500)


def test_a_velocity_towards_the_position_limit_is_a_fault_before_it(master: Master) -> None:
    cycle = Cycle(master, TARGET_VELOCITY)
    master.write(0x6060, 0, CSV, 1)
    here = cycle.run(0, 0, 1)[3]
    master.write(0x607D, 2, here + SPEED, 4)
    cycle.enable()
    cycle.run(ENABLE, SPEED, 200)
    master.settle(lambda: 0x8612 in master.emergencies)
    master.settle(lambda: not master.truth()["energised"])
    assert master.number(0x6064) < here + 210000


@pytest.mark.slow
def test_speed_and_torque_stay_below_their_limits(master: Master) -> None:
    master.write(0x6080, 0, 60, 4)  # rev/min
    cycle = master.enabled(CSV, TARGET_VELOCITY)
    word, velocity, *_ = cycle.run(ENABLE, SPEED, 100)
    assert word & 0x0800
    assert velocity == pytest.approx(INCREMENTS, rel=0.05)
    master.write(0x6072, 0, 10, 2)  # below friction: it comes to a stop
    _, velocity, permille, _ = cycle.run(ENABLE, SPEED, 200)
    assert abs(velocity) < 1000
    assert permille <= 11


def test_an_unknown_mode_is_not_shown(master: Master) -> None:
    master.write(0x6060, 0, CSV, 1)
    for mode in (2, 4, 6, 7, 8, 10, -1):
        master.write(0x6060, 0, mode, 1)
        assert master.number(0x6061) == CSV


@pytest.mark.parametrize(("option", "state"), [(0, 0x40), (2, 0x40), (6, 0x07)])
def test_quick_stop_as_its_option_says(master: Master, option: int, state: int) -> None:
    master.write(0x605A, 0, option, 2)
    cycle = turning(master)
    cycle.run(QUICK_STOP, SPEED, 1)
    master.settle(lambda: abs(master.truth()["velocity"]) < 1e-5)
    assert cycle.run(QUICK_STOP, SPEED, 20)[0] & 0x6F == state
    assert abs(master.truth()["velocity"]) < 1e-5


def test_a_set_point_left_behind_counts(master: Master) -> None:
    """Nothing clears 60FFh: a host that enables without writing it gets what it wrote before."""
    cycle = Cycle(master, TARGET_VELOCITY)
    master.write(0x6060, 0, CSV, 1)
    for word in (SHUT_DOWN, SWITCH_ON):
        cycle.run(word, SPEED, 1)
    cycle.run(ENABLE, SPEED, 50)
    assert master.truth()["velocity"] == pytest.approx(SPEED * JOINT, rel=0.1)


def test_a_mode_changes_at_standstill(master: Master) -> None:
    cycle = turning(master)
    master.write(0x6060, 0, PV, 1)
    assert master.number(0x6061) == CSV
    cycle.run(ENABLE, 0, 100)
    assert master.number(0x6061) == PV


@pytest.mark.parametrize(("option", "state"), [(1, 0x08), (2, 0x40), (3, 0x40)])
def test_nmt_stop_is_an_aborted_connection(master: Master, option: int, state: int) -> None:
    master.write(0x6007, 0, option, 2)
    turning(master)
    master.node.nmt.state = "STOPPED"
    master.settle(lambda: not master.truth()["energised"])
    master.node.nmt.state = "PRE-OPERATIONAL"
    assert master.number(0x6041) & 0x4F == state


def test_pre_operational_alone_stops_nothing(master: Master) -> None:
    """Nor does a SYNC that stays away: the axis turns on until somebody says otherwise."""
    turning(master)
    master.node.nmt.state = "PRE-OPERATIONAL"
    before = master.truth()["position"]
    master.settle(lambda: master.truth()["position"] > before + 0.01)
    master.write(0x6040, 0, QUICK_STOP, 2)
    master.settle(lambda: not master.truth()["energised"])


def test_a_halt_holds_and_its_end_goes_on(master: Master) -> None:
    cycle = turning(master)
    cycle.run(ENABLE | 0x100, SPEED, 1)
    master.settle(lambda: abs(master.truth()["velocity"]) < 1e-5)
    cycle.run(ENABLE | 0x100, SPEED, 20)
    assert abs(master.truth()["velocity"]) < 1e-5
    cycle.run(ENABLE, SPEED, 100)
    assert master.truth()["velocity"] == pytest.approx(SPEED * JOINT, rel=0.05)
