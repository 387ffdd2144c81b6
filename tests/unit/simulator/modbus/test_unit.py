"""A unit's registers against its dictionary, and its watchdog; the clock is in the test's hand."""

from collections.abc import Callable
from pathlib import Path

import pytest
from pymodbus.constants import ExcCodes
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.bit_message import ReadCoilsRequest
from pymodbus.pdu.mei_message import ReadDeviceInformationRequest
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadInputRegistersRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

from simulator import load_scenario
from simulator.machine import LiveMachine
from simulator.modbus.line import ModbusCabinet, ModbusUnit, Refusal
from simulator.modbus.registers import RegisterLayout, load_register_map

CONFIG = Path(__file__).parents[4] / "config"
ADDRESS, VALUE, STATE = ExcCodes.ILLEGAL_ADDRESS, ExcCodes.ILLEGAL_VALUE, ExcCodes.DEVICE_FAILURE


class Bench:
    """A cabinet on a Modbus line, without the line."""

    def __init__(self, machine: LiveMachine, registers: RegisterLayout) -> None:
        self.registers = registers
        self.now = 1000.0
        self.cabinet = ModbusCabinet(machine, CONFIG / "eds/virtual-axis.eds", registers, 5.0)
        self.cabinet.boot()
        self.unit: ModbusUnit = self.cabinet.nodes["joint_1"]

    def put(self, name: str, value: float) -> None:
        signal = self.registers.signals[name]
        self.unit.write(signal.address, signal.encode(value, self.registers.word_order))

    def get(self, name: str) -> float:
        signal = self.registers.signals[name]
        return signal.decode(self.unit.read(signal.address, signal.registers), self.registers.word_order)

    def ask(self, request: ModbusPDU, unit: int = 1) -> ModbusPDU | None:
        request.dev_id = unit
        return self.cabinet.answer(request, self.now)

    def enable(self) -> None:
        self.put("mode", 1)
        for controlword in (6, 7, 15):
            self.put("controlword", controlword)
        self.cabinet.switch()

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.004)):
            self.now += 0.004
            self.cabinet.run(self.now)

    @property
    def state(self) -> str:
        return self.unit.axis.state.name


@pytest.fixture(scope="module", params=["high", "low"])
def shared(request: pytest.FixtureRequest) -> Bench:
    """One for the module: reading six EDS takes long."""
    registers = load_register_map(CONFIG / f"registers/virtual-{request.param}-first.yaml")
    return Bench(LiveMachine(load_scenario(CONFIG / "scenarios/max100-rigid.yaml"), 1), registers)


@pytest.fixture
def bench(shared: Bench) -> Bench:
    """Everything as at power-on, but for where the axes stand."""
    for number, unit in enumerate(shared.cabinet.nodes.values(), 1):
        unit.renumber(number)
        unit.disturbance.mute = False
    shared.cabinet.switch()
    return shared


def refused(act: Callable[..., object], *given: object) -> ExcCodes:
    with pytest.raises(Refusal) as caught:
        act(*given)
    return caught.value.code


def test_every_writable_signal_comes_back_as_it_was_written(bench: Bench) -> None:
    values = {
        "target_position": 12.345678,
        "profile_velocity": 123.4,
        "profile_acceleration": 500.5,
        "profile_deceleration": 400.25,
        "quick_stop_deceleration": 3000.0,
        "max_torque": 1500,
        "max_speed": 90.12,
        "position_min": -12.5,
        "position_max": 13.25,
        "quick_stop_option": 6,
        "shutdown_option": 0,
        "disable_option": 0,
        "halt_option": 2,
        "fault_option": 1,
        "connection_loss_option": 3,
        "watchdog": 800,
        "control_owner": 4711,
        "mode": 1,
        "controlword": 0,
        "measuring_command": 0,
        "offset_speed": -17.1,
        "ramp": 0.25,
        "settle": 0.125,
        "period": 1.5,
        "periods": 7,
        "sines": 3,
        "trace_cycle": 2,
        "page_first": 70000,
        "page_count": 12,
        "frequency": 2.123456,
        "amplitude": -3.1234,
        "phase": 3.141593,
    }
    assert values.keys() == {name for name, signal in bench.registers.signals.items() if signal.access == "rw"}
    for name, value in values.items():
        bench.put(name, value)
    for name, value in values.items():
        assert bench.get(name) == pytest.approx(value, rel=2e-7, abs=1.1e-6), name
    d = bench.unit.dictionary
    assert d[0x607A, 0] == round(12.345678 * 2**20)
    assert (d[0x6081, 0], d[0x6085, 0], d[0x6080, 0]) == (123_400, 3_000_000, 90_120)
    assert d[0x2100, 4] == pytest.approx(-17.1)


def test_what_is_refused_and_how(bench: Bench) -> None:
    unit, most = bench.unit, bench.registers.trace.capacity
    wide = bench.registers.signals["target_position"].address
    for address, count in ((wide, 1), (wide + 1, 1), (wide + 1, 2), (0xFFF0, 1), (0xFFFF, 2)):
        assert refused(unit.read, address, count) is ADDRESS
    for address, words in ((wide, [1]), (wide + 1, [1, 2]), (bench.registers.trace.page.address, [1])):
        assert refused(unit.write, address, words) is ADDRESS
    assert refused(unit.read, wide, bench.registers.max_read + 1) is VALUE
    assert refused(bench.put, "statusword", 1) is ADDRESS
    for name, value in (("mode", 9), ("mode", 3), ("sines", 17), ("quick_stop_option", 9), ("page_count", most + 1)):
        assert refused(bench.put, name, value) is VALUE
    assert bench.get("page_count") == most
    assert bench.get("mode_display") == 0


def test_states_that_refuse(bench: Bench) -> None:
    bench.enable()
    bench.put("target_position", 5.0)
    bench.put("controlword", 0x1F)
    bench.wait(0.1)
    assert refused(bench.put, "mode", 0) is STATE
    assert bench.get("mode_display") == 1


def test_watchdog_of_an_enabled_axis(bench: Bench) -> None:
    bench.put("watchdog", 200)
    bench.unit.hear(bench.now)
    bench.wait(0.3)
    assert bench.state == "SWITCH_ON_DISABLED"  # not enabled: nothing to stop
    bench.unit.hear(bench.now)
    bench.enable()
    for _ in range(6):
        bench.wait(0.1)
        bench.unit.hear(bench.now)
    assert bench.state == "OPERATION_ENABLED"
    assert bench.cabinet.due(bench.now) <= 0.2
    bench.wait(0.25)
    assert (bench.state, bench.get("error_code")) == ("FAULT", 0x8130)
    bench.put("controlword", 0)
    bench.put("controlword", 0x80)
    assert (bench.state, bench.get("error_code")) == ("SWITCH_ON_DISABLED", 0)
    bench.unit.boot()
    assert bench.get("watchdog") == 0


@pytest.mark.parametrize(
    ("option", "state"), [(0, "OPERATION_ENABLED"), (2, "SWITCH_ON_DISABLED"), (3, "SWITCH_ON_DISABLED")]
)
def test_what_the_watchdog_does_to_a_move_is_the_connection_loss_option(bench: Bench, option: int, state: str) -> None:
    bench.put("connection_loss_option", option)
    bench.put("watchdog", 100)
    bench.unit.hear(bench.now)
    bench.enable()
    start = bench.get("position")
    bench.put("target_position", start + 60.0)
    bench.put("controlword", 0x1F)
    bench.wait(0.4)
    assert (bench.state, bench.get("error_code")) == (state, 0)
    if option != 0:
        assert start < bench.get("position") < start + 30


def test_a_request_is_for_one_unit_and_the_mute_still_hear(bench: Bench) -> None:
    signal = bench.registers.signals["halt_option"]
    words = signal.encode(2, bench.registers.word_order)

    def write() -> ModbusPDU:
        request = WriteMultipleRegistersRequest(address=signal.address, registers=words)
        request.byte_count = 2 * len(words)
        return request

    assert bench.ask(write(), unit=7) is None
    assert bench.ask(write(), unit=0) is None
    bench.cabinet.nodes["joint_2"].disturbance.mute = True
    assert bench.ask(write(), unit=2) is None
    assert [unit.dictionary[0x605D, 0] for unit in bench.cabinet.nodes.values()] == [1, 2, 1, 1, 1, 1]
    bench.cabinet.nodes["joint_1"].renumber(7)
    assert bench.ask(write(), unit=1) is None
    assert bench.ask(write(), unit=7) is not None
    assert bench.get("serial") == 1001


def test_functions(bench: Bench) -> None:
    signal = bench.registers.signals["serial"]
    for kind in (ReadHoldingRegistersRequest, ReadInputRegistersRequest):
        response = bench.ask(kind(address=signal.address, count=2), unit=3)
        assert response is not None
        assert response.function_code == kind.function_code
        assert signal.decode(response.registers, bench.registers.word_order) == 1003
    request = WriteMultipleRegistersRequest(address=signal.address, registers=[1, 2])
    request.byte_count = 2
    for bad, code in (
        (ReadCoilsRequest(address=0, count=1), ExcCodes.ILLEGAL_FUNCTION),
        (request, VALUE),
        (WriteSingleRegisterRequest(address=signal.address, registers=[1]), ADDRESS),
        (ReadDeviceInformationRequest(read_code=7), VALUE),
        (ReadDeviceInformationRequest(read_code=4, object_id=5), ADDRESS),
    ):
        response = bench.ask(bad)
        assert isinstance(response, ExceptionResponse)
        assert response.exception_code == code
    halt = bench.registers.signals["halt_option"]
    response = bench.ask(WriteSingleRegisterRequest(address=halt.address, registers=[2]))
    assert isinstance(response, ExceptionResponse) is (halt.registers > 1)
    assert bench.get("halt_option") == (1 if halt.registers > 1 else 2)


@pytest.mark.parametrize(
    ("code", "first", "objects"), [(1, 0, [0, 1, 2]), (2, 1, [1, 2]), (3, 0, [0, 1, 2, 0x80]), (4, 0x80, [0x80])]
)
def test_identification(bench: Bench, code: int, first: int, objects: list[int]) -> None:
    texts = {0: "00005357", 1: "00000402", 2: "00010000", 0x80: "000003EB"}
    response = bench.ask(ReadDeviceInformationRequest(read_code=code, object_id=first), unit=3)
    assert getattr(response, "information", None) == {number: texts[number] for number in objects}


def test_a_unit_keeps_one_owner_until_it_releases_or_falls_silent(bench: Bench) -> None:
    bench.put("watchdog", 200)
    bench.unit.hear(bench.now)
    bench.put("control_owner", 4711)
    with pytest.raises(Refusal, match="DEVICE_FAILURE"):
        bench.put("control_owner", 4712)
    assert bench.get("control_owner") == 4711
    bench.put("control_owner", 0)
    bench.put("control_owner", 4712)
    bench.now += 0.15
    bench.unit.hear(bench.now)
    bench.put("control_owner", 4712)
    bench.now += 0.19
    bench.unit.hear(bench.now)
    assert bench.get("control_owner") == 4712
    bench.now += 0.02
    bench.unit.hear(bench.now)
    assert bench.get("control_owner") == 0
    bench.put("control_owner", 4711)


def test_an_owner_that_falls_silent_is_a_lost_host_whoever_else_asks(bench: Bench) -> None:
    bench.put("watchdog", 200)
    bench.unit.hear(bench.now)
    bench.put("control_owner", 4711)
    bench.enable()
    for _ in range(10):
        bench.unit.hear(bench.now)  # another host
        bench.wait(0.03)
    assert bench.get("error_code") == 0x8130
