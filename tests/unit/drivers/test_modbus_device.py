"""The device over both register maps on a real line: its identity, settings, trace, stop and loss."""

import math
import threading
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from drivers.cia402.axis import Cia402Axis
from drivers.cia402.device import OperationMode, await_mode
from drivers.cia402.host_watch import HostWatch
from drivers.errors import (
    CommunicationLost,
    DriveError,
    DriveFault,
    LimitExceeded,
    WrongConfiguration,
    WrongIdentity,
)
from drivers.modbus.device import ModbusDevice
from drivers.modbus.line import MasterLine
from drivers.modbus.profile import RtuProfile
from drivers.modbus.registers import RegisterMap, load_registers
from drivers.ports import AxisState, SineCommand
from tests.unit.drivers.given import sweep
from tests.unit.drivers.modbus_bank import (
    HIGH,
    KINDS,
    LOW,
    MAPS,
    Bank,
    drive,
    following,
    get,
    nobody,
    profile_on,
    put,
    serving,
)
from tests.unit.drivers.test_bus import soon

SWEEP = sweep(
    SineCommand(2.0, 0.002, 0.3),
    SineCommand(4.0, 0.002, 1.1),
    offset_velocity=0.0105,
    periods=5,
    ramp=0.5,
    settle=0.5,
    velocity_limit=0.05,
    effort_limit=5000.0,
    position_window=(-1.0, 1.0),
)


@contextmanager
def connected(
    kind: str, registers: RegisterMap | None = None, timeout: float = 0.5, **axis: Any
) -> Generator[tuple[Bank, ModbusDevice]]:
    """One drive of the profile `kind`, and the device that reads it through `registers`."""
    real = HIGH if kind == "tcp" else LOW
    bank = Bank(kind)
    drive(bank, real, 1, 17.544)
    following(bank, real)
    with serving(bank, timeout) as served:
        profile = profile_on(served, kind, **axis)
        line = MasterLine(profile.line)
        line.open()
        yield bank, ModbusDevice(profile.axes[0], profile, registers or real, "0" * 64, line, nobody())
        line.close()


@KINDS
def test_identity(kind: str, registers: RegisterMap) -> None:
    with connected(kind) as (bank, device):
        identity = device.identify()
        assert (identity.address, identity.serial, identity.vendor) == ("unit 1", 1001, 0x5357)
        for name, value, message in (
            ("product", 7, "product is 00000007h, the profile says 00000402h"),
            ("revision", 0x10001, "revision is 00010001h, the profile says 00010000h"),
            ("rated_torque", 17.6, r"rated torque of the motor is 17\.6 N m"),  # 0.3 % more
            ("constant", 0x01020304, r"reads 01020304h, the register map says .* it would be 03040102h"),
        ):
            before = get(bank, registers, name)
            put(bank, registers, 1, name, value)
            with pytest.raises(WrongIdentity, match=message):
                device.identify()
            put(bank, registers, 1, name, before)
        put(bank, registers, 1, "rated_torque", 17.56)  # 0.1 % more
        device.identify()
        assert device.configure().host_watchdog
        put(bank, registers, 1, "serial", 4711)
        with pytest.raises(WrongIdentity, match="at connect it was 000003E9h"):
            device.read_back()


@KINDS
def test_the_wrong_word_order_is_told_with_both_readings(kind: str, registers: RegisterMap, tmp_path: Path) -> None:
    name = "high" if kind == "tcp" else "low"
    other = "low" if kind == "tcp" else "high"
    text = (MAPS / f"virtual-{name}-first.yaml").read_text().replace(f"{name}_first", f"{other}_first")
    (tmp_path / "turned.yaml").write_text(text)
    value = registers.constant
    turned = (value & 0xFFFF) << 16 | value >> 16
    with (
        connected(kind, load_registers(tmp_path / "turned.yaml")) as (_, device),
        pytest.raises(
            WrongIdentity,
            match=rf"reads {turned:08X}h, the register map says {value:08X}h; .*{name}_first' both agree: "
            "correct word_order in the map",
        ),
    ):
        device.identify()


@KINDS
def test_settings_are_written_once_and_read_back(kind: str, registers: RegisterMap) -> None:
    with connected(kind) as (bank, device):
        device.identify()
        device.configure()
        assert get(bank, registers, "watchdog") == pytest.approx(10_000)
        assert get(bank, registers, "connection_loss_option") == 1
        assert get(bank, registers, "quick_stop_deceleration") == pytest.approx(4.0 * 171 * 60 / math.tau, abs=0.01)
        assert get(bank, registers, "position_min") == pytest.approx(-2.96 * 171 / math.tau, abs=1e-5)
        assert get(bank, registers, "max_torque") == math.floor(6000 / (17.544 * 171) * 1e3)
        written = sum(request.function == 16 for request in bank.requests)
        device.read_back()
        device.settle_limits(1.0, 6000.0, (-2.96, 2.96))
        assert sum(request.function == 16 for request in bank.requests) == written
        put(bank, registers, 1, "halt_option", 0)
        bank.react = lambda _: put(bank, registers, 1, "halt_option", 7)
        with pytest.raises(WrongConfiguration, match=r"joint_1 \(unit 1\): halt_option .* wrote 1, drive holds 7"):
            device.read_back()


@KINDS
def test_a_drive_that_restarted_gets_no_energy_before_a_person_knows(kind: str, registers: RegisterMap) -> None:
    with connected(kind) as (bank, device):
        axis = Cia402Axis(device, HostWatch(60.0))
        axis.introduce()
        put(bank, registers, 1, "watchdog", 0)
        with pytest.raises(DriveFault, match="drive restarted, its settings are lost"):
            axis.enable(threading.Event())
        assert axis.status().state is AxisState.FAULT
        assert get(bank, registers, "statusword") == 0x40
        axis.acknowledge()
        assert get(bank, registers, "watchdog") == pytest.approx(10_000)
        axis.enable(threading.Event())
        assert axis.status().state is AxisState.ENABLED


@KINDS
def test_a_swapped_drive_gets_no_energy(kind: str, registers: RegisterMap) -> None:
    with connected(kind) as (bank, device):
        axis = Cia402Axis(device, HostWatch(60.0))
        axis.introduce()
        put(bank, registers, 1, "serial", 1003)
        with pytest.raises(WrongIdentity, match=r"serial is 000003EBh, at connect it was 000003E9h"):
            axis.enable(threading.Event())
        assert get(bank, registers, "statusword") == 0x40


@KINDS
def test_a_lost_drive_is_told_to_stop_all_the_same(kind: str, registers: RegisterMap) -> None:
    address, low_word = registers.signals["controlword"].address, -1 if kind == "tcp" else 0
    with connected(kind) as (bank, device):
        bank.spoil = lambda _r, _f: None
        device.stop_unheard()
        soon(lambda: [r.words[low_word] for r in bank.requests if r.address == address] == [0x02, 0x00])


@KINDS
def test_a_turned_gear_turns_the_signs(kind: str, registers: RegisterMap) -> None:
    with connected(kind, gear_ratio=-171.0) as (bank, device):
        put(bank, registers, 1, "velocity", -171.0)
        assert device.motion().velocity == pytest.approx(math.tau / 60)
        device.settle_limits(1.0, 6000.0, (-1.0, 2.0))
        assert get(bank, registers, "position_min") == pytest.approx(-2.0 * 171 / math.tau, abs=1e-5)
        assert get(bank, registers, "max_torque") > 0
        assert get(bank, registers, "max_speed") == pytest.approx(171 * 60 / math.tau, rel=1e-4)


def test_mode_that_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(await_mode, "__defaults__", (0.05,))
    with connected("tcp") as (bank, device):
        device.set_mode(OperationMode.PROFILE_POSITION)
        bank.react = lambda _: None
        with pytest.raises(WrongConfiguration, match="mode 9 was not accepted, the drive reports mode 1"):
            device.set_mode(OperationMode.CYCLIC_VELOCITY)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sines": (SineCommand(2.0, 1e-6, 0.0),)}, r"amplitude 1 \(0820h\): .* in the drive's steps"),
        ({"sines": (SineCommand(2.0000004, 0.002, 0.0),), "periods": 3000}, r"frequency 1 \(0800h\)"),
        ({"period": 1e9}, r"period \(0709h\): 1e\+09 does not fit u32"),
        ({"sines": (SineCommand(2.0, 0.002, 1e6),)}, r"phase 1 \(0840h\): 1e\+06 does not fit i32"),
    ],
)
def test_what_the_registers_cannot_hold_well_enough_is_refused(change: dict[str, Any], message: str) -> None:
    with connected("rtu") as (bank, device):
        with pytest.raises(LimitExceeded, match=message):
            device.prepare_measuring(replace(SWEEP, **change))
        assert LOW.signals["sines"].address not in {r.address for r in bank.requests if r.function == 16}


def fill_trace(bank: Bank, registers: RegisterMap, first: int, count: int, load: float = 0.25) -> None:
    trace = registers.trace
    assert trace is not None
    address = trace.address
    for number in range(first, first + count):
        row = {"cycle": number, "torque": 1.5, "set_speed": 100.0, "speed": 99.0, "position": 42.75}
        for name, form in trace.sample:
            value = row.get(name, load)
            words = form.encode(form.least if math.isnan(value) else value)
            bank.registers[1].update(zip(range(address, address + form.width), words, strict=True))
            address += form.width


@KINDS
def test_trace_pages(kind: str, registers: RegisterMap) -> None:
    with connected(kind, load_encoder_direction=-1) as (bank, device):
        device.prepare_measuring(SWEEP)
        fill_trace(bank, registers, 40, device.page_size)
        bank.requests.clear()
        block = device.page(40, device.page_size)
        assert (get(bank, registers, "page_first"), get(bank, registers, "page_count")) == (40, device.page_size)
        assert block.index.tolist() == list(range(40, 40 + device.page_size))
        assert block.time[0] == pytest.approx(40 * 0.004)
        assert block.effort == pytest.approx(1.5 * 171)
        assert block.velocity == pytest.approx(99 * math.tau / 60 / 171)
        assert block.velocity_setpoint == pytest.approx(100 * math.tau / 60 / 171)
        assert block.position == pytest.approx(math.pi / 2, abs=1e-6)
        assert block.load_position == pytest.approx(-math.pi / 2)
        trace = registers.trace
        assert trace is not None
        reads = [request for request in bank.requests if request.function == 3]
        assert all(r.count <= registers.max_read and r.count % trace.width == 0 for r in reads)
        with pytest.raises(CommunicationLost, match="trace page from 41 holds other samples"):
            device.page(41, 5)
        fill_trace(bank, registers, 40, 5, load=math.nan)
        with pytest.raises(WrongConfiguration, match="the trace holds none"):
            device.page(40, 5)


def test_a_page_leaves_room_for_a_stop() -> None:
    with connected("tcp") as (_, device):
        assert device.page_size == 250  # 25 requests of 10 samples
    with connected("rtu") as (_, device):
        line = RtuProfile(transport="rtu", device="any", baudrate=115200, parity="N", timeout=0.5, watchdog=10.0)
        assert device.page_size == 5 * math.floor(0.1 / line.read_time(60))


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(noise=st.lists(st.binary(max_size=24), min_size=1, max_size=4), cut=st.integers(0, 6))
@pytest.mark.parametrize("kind", ["tcp", "rtu"])
def test_noise_never_leads_to_an_enabling_write(kind: str, noise: list[bytes], cut: int) -> None:
    with connected(kind, timeout=0.01) as (bank, device):
        bank.spoil = lambda _, frame: noise[len(bank.requests) % len(noise)] + frame[:cut]
        axis = Cia402Axis(device, HostWatch(60.0))
        enable = partial(axis.enable, threading.Event())
        for attempt in (axis.introduce, enable, axis.status, axis.acknowledge, axis.start_measuring):
            with suppress(DriveError):
                attempt()
        address = (HIGH if kind == "tcp" else LOW).signals["controlword"].address
        written = {word for r in bank.requests if r.function == 16 and r.address == address for word in r.words}
        assert written <= {0x00, 0x02}
