"""The measuring function: sweeps, torque noise, and the speed control that is softened under it."""

import struct
from collections.abc import Callable

import numpy as np
import pytest

from simulator import Scenario
from simulator.canopen.line import CanopenCabinet
from simulator.canopen.pdo import Frame
from simulator.drive.dictionary import AbortCode, ObjectDictionary, SdoAbort
from simulator.drive.measuring import FunctionState, Rejection
from simulator.drive.power_drive import DriveState
from simulator.machine import LiveMachine
from simulator.waveform import torque_noise
from tests.unit.simulator.conftest import EDS, Rig

SINES = ((2.0, 6.0, 0.3), (5.0, 12.0, -1.0))  # Hz, rev/min, rad
RECORD = struct.Struct("<Ifffdd")


def parameters(dictionary: ObjectDictionary, **changed: float) -> None:
    d = dictionary
    d[0x2100, 4], d[0x2100, 5], d[0x2100, 6], d[0x2100, 7] = 60.0, 0.5, 1.0, 1.0
    d[0x2100, 8], d[0x2100, 9], d[0x2100, 0x0A] = 2, 2, 4
    for sub, sine in enumerate(SINES, 1):
        for index, value in zip((0x2101, 0x2102, 0x2103), sine, strict=True):
            d[index, sub] = value
    for name, value in changed.items():
        d[0x2100, {"offset": 4, "ramp": 5, "period": 7}[name]] = value


def command(dictionary: ObjectDictionary, value: int = 1) -> None:
    dictionary.download(0x2100, 1, struct.pack("<H", value))


def by_hand(time: float) -> float:
    """The set-point in rev/min without its envelope, s after the start."""
    t = time - 1.5
    return 60 + 6 * np.sin(2 * np.pi * 2 * t + 0.3) + 12 * np.sin(2 * np.pi * 5 * t - 1)


def test_a_run_from_start_to_page(dictionary: ObjectDictionary, rig: Rig) -> None:
    parameters(dictionary)
    rig.enable(1)
    command(dictionary)
    assert dictionary[0x2100, 2] == FunctionState.RUNNING
    with pytest.raises(SdoAbort) as twice:
        command(dictionary)
    assert twice.value.code is AbortCode.STATE
    speeds = rig.turn(2000, 10)
    assert speeds[1999] * 60 == pytest.approx(by_hand(2.0))
    assert speeds[249] * 60 == pytest.approx(by_hand(0.25) / 2)  # half-way up the raised cosine
    assert dictionary[0x2100, 0x0B] == 500
    assert len(dictionary.upload(0x2110, 3)) == 500 * 32  # while it runs
    rig.turn(2000, 10)
    assert dictionary[0x2100, 2] == FunctionState.DONE
    assert dictionary[0x2100, 0x0B] == 1000
    assert not rig.axis.moving
    dictionary[0x2110, 1], dictionary[0x2110, 2] = 998, 512
    page = dictionary.upload(0x2110, 3)
    assert [RECORD.unpack_from(page, at)[0] for at in (0, 32)] == [998, 999]
    dictionary[0x2110, 1] = 1000
    with pytest.raises(SdoAbort) as empty:
        dictionary.upload(0x2110, 3)
    assert empty.value.code is AbortCode.NO_DATA


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        (None, Rejection.NOT_ENABLED),
        ({"offset": 3000.0}, Rejection.SPEED),
        ({"offset": 2900.0}, Rejection.POSITION_WINDOW),  # 50 rev/s for 3 s
        ({"ramp": 0.0}, Rejection.PARAMETERS),
        ({"period": float("nan")}, Rejection.PARAMETERS),
        ({"period": 1e9}, Rejection.PARAMETERS),
    ],
)
def test_rejections(
    dictionary: ObjectDictionary, rig: Rig, changed: dict[str, float] | None, reason: Rejection
) -> None:
    parameters(dictionary, **(changed or {}))
    if changed is not None:
        rig.enable(1)
    command(dictionary)
    assert (dictionary[0x2100, 2], dictionary[0x2100, 3]) == (FunctionState.REJECTED, reason)
    assert rig.axis.setpoints(8) == pytest.approx(np.zeros(8))


def test_abort_brings_it_to_standstill_and_keeps_the_trace(dictionary: ObjectDictionary, rig: Rig) -> None:
    parameters(dictionary)
    rig.enable(1)
    command(dictionary)
    rig.turn(1600)
    before = dictionary.upload(0x2110, 3)
    command(dictionary, 2)
    speeds = rig.turn(80)
    assert np.all(np.diff(np.abs(speeds)) <= 1e-12)
    assert speeds[-1] == pytest.approx(0.0)
    assert dictionary[0x2100, 2] == FunctionState.ABORTED
    assert rig.state is DriveState.OPERATION_ENABLED
    assert dictionary.upload(0x2110, 3) == before
    command(dictionary)
    assert dictionary[0x2100, 2] == FunctionState.RUNNING


@pytest.fixture
def ready(dictionary: ObjectDictionary) -> ObjectDictionary:
    """Parameters of 0.2 N m (1 % of rated torque) from 1 to 40 Hz, two periods of 1 s; a commissioned control."""
    d = dictionary
    d[0x2100, 4], d[0x2100, 5], d[0x2100, 6], d[0x2100, 7] = 17.0, 0.5, 1.0, 1.0
    d[0x2100, 8], d[0x2100, 9], d[0x2100, 0x0A], d[0x2100, 0x0C] = 2, 0, 4, 1
    d[0x2104, 1], d[0x2104, 2], d[0x2104, 3], d[0x2104, 4] = 0.2, 1.0, 40.0, 11
    d[0x2140, 1], d[0x2140, 2] = d[0x2140, 3], d[0x2140, 4] = 0.5, 0.1
    return d


def write(dictionary: ObjectDictionary, sub: int, value: float) -> None:
    dictionary.download(0x2140, sub, struct.pack("<d", value))


def test_one_period_by_the_formula() -> None:
    torque = torque_noise(3.0, 0.9, 5.2, 2.0, seed=5, cycle=0.001)
    assert len(torque) == 2000
    assert np.sqrt(np.mean(torque**2)) == pytest.approx(3.0)
    lines, phases = np.arange(2, 11) / 2.0, np.random.default_rng(5).uniform(0, 2 * np.pi, 9)  # 1.0 to 5.0 Hz
    by_hand = (3.0 * np.sqrt(2 / 9) * np.sin(2 * np.pi * lines * 0.345 + phases)).sum()
    assert torque[344] == pytest.approx(by_hand)


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [
        ((0x2104, 1), -1.0, Rejection.PARAMETERS),
        ((0x2104, 1), float("nan"), Rejection.PARAMETERS),
        ((0x2104, 1), 20.0, Rejection.TORQUE),  # the rated torque, which 6072h allows: its peaks are above
        ((0x2104, 2), 40.5, Rejection.PARAMETERS),
        ((0x2104, 3), 501.0, Rejection.PARAMETERS),
        ((0x2104, 3), float("inf"), Rejection.PARAMETERS),
        ((0x2104, 3), 0.5, Rejection.PARAMETERS),
        ((0x2100, 7), 1.0005, Rejection.PARAMETERS),  # the period is not whole cycles
    ],
)
def test_rejections_of_noise(
    ready: ObjectDictionary, rig: Rig, key: tuple[int, int], value: float, reason: Rejection
) -> None:
    ready[key] = value
    rig.enable(1)
    command(ready)
    assert (ready[0x2100, 2], ready[0x2100, 3]) == (FunctionState.REJECTED, reason)
    assert rig.axis.measuring.injection(8) == pytest.approx(np.zeros(8))


ENDS: dict[str, Callable[[Rig], None]] = {
    "abort": lambda rig: command(rig.dictionary, 2),
    "quick stop": lambda rig: rig.axis.quick_stop(),
    "fault": lambda rig: rig.axis.fail(0x7305),
    "emergency stop": lambda rig: rig.axis.stop_safely(on=True),
    "torque off": lambda rig: rig.axis.disable_voltage(),
}


@pytest.mark.parametrize("end", ENDS)
def test_whatever_ends_the_run_ends_the_injection(ready: ObjectDictionary, rig: Rig, end: str) -> None:
    rig.enable(1)
    command(ready)
    rig.turn(1600)
    ENDS[end](rig)
    assert rig.axis.measuring.injection(80) == pytest.approx(np.zeros(80))
    rig.turn(400)
    assert ready[0x2100, 2] == FunctionState.ABORTED
    assert rig.axis.energised is (end == "abort")
    assert rig.turn(80) == pytest.approx(np.zeros(80))


@pytest.mark.parametrize(
    ("sub", "value", "code"),
    [
        (1, 0.0, AbortCode.TOO_LOW),
        (1, float("nan"), AbortCode.TOO_LOW),
        (1, 0.51, AbortCode.TOO_HIGH),
        (2, 0.09, AbortCode.TOO_LOW),
        (2, float("nan"), AbortCode.TOO_LOW),
        (2, float("inf"), AbortCode.TOO_HIGH),
        (3, 0.4, AbortCode.READ_ONLY),
        (4, 0.4, AbortCode.READ_ONLY),
    ],
)
def test_the_speed_control_becomes_softer_only(
    ready: ObjectDictionary, rig: Rig, sub: int, value: float, code: AbortCode
) -> None:
    write(ready, 1, 0.25)
    write(ready, 2, 0.2)
    assert rig.axis.speed_control.softened
    with pytest.raises(SdoAbort) as refused:
        write(ready, sub, value)
    assert refused.value.code is code
    assert rig.axis.speed_control.active == (0.25, 0.2)


@pytest.mark.parametrize("end", ["fault", "emergency stop", "host lost", "host lost, no reaction"])
@pytest.mark.parametrize("enabled", [True, False])
def test_the_drive_itself_restores_the_commissioned_control(
    ready: ObjectDictionary, rig: Rig, end: str, enabled: bool
) -> None:
    if enabled:
        rig.enable(1)
    write(ready, 1, 0.25)
    write(ready, 2, 0.2)
    if end == "fault":
        rig.axis.fail(0x7305)
    elif end == "emergency stop":
        rig.axis.stop_safely(on=True)
    else:
        ready[0x6007, 0] = 0 if "no" in end else 3
        rig.axis.lose_host()
    assert rig.axis.speed_control.active == (0.5, 0.1)
    assert not rig.axis.speed_control.softened


def test_the_machine_follows_and_a_reboot_restores(scenario: Callable[[str], Scenario]) -> None:
    """The same step of the set-point under commissioned, softened and restored control."""
    machine = LiveMachine(scenario("rigid"), 1)
    cabinet = CanopenCabinet(machine, EDS, 1.0, lambda _: None)
    cabinet.boot()
    node = cabinet.nodes["joint_1"]
    commissioned = machine.scenario.axes["joint_1"].control
    ratio = machine.axes[0].gear_ratio
    assert node.axis.speed_control.active == (pytest.approx(commissioned.gain / ratio**2), commissioned.reset_time)
    gain = node.dictionary[0x2140, 3]

    def torque() -> float:
        """Of the first cycle of an abrupt start, N m."""
        for controlword in (0x06, 0x07, 0x0F):
            node.axis.control(controlword)
        cabinet.switch()
        node.dictionary[0x2100, 5] = 1e-3  # s, ramp
        node.dictionary[0x2100, 4] = 10.0
        node.receive(Frame(0x601, struct.pack("<BHBH2x", 0x2B, 0x2100, 1, 1)), 0.0)
        assert node.axis.measuring.run is FunctionState.RUNNING
        cabinet.advance(4)
        effort = float(node.dictionary[0x6077, 0])
        node.axis.disable_voltage()
        cabinet.switch()
        return effort

    stiff = torque()
    write(node.dictionary, 1, gain / 4)
    assert torque() == pytest.approx(stiff / 4, rel=0.2)
    node.boot()
    assert not node.axis.speed_control.softened
    assert torque() == pytest.approx(stiff, rel=0.1)
