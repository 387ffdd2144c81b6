"""The stop of Modbus TCP drives before units that answer at once, late, badly and never."""

from pathlib import Path

import pytest
import yaml

from drivers.errors import ConnectionFailed
from drivers.modbus.profile import RtuLine, TcpLine, parse_profile
from drivers.modbus.registers import load_registers
from drivers.modbus.stop_sender import ModbusStopSender
from tests.unit.drivers.modbus_bank import Bank, Request, serving

ANYTHING = dict.fromkeys(range(0x10000), 0)
UNITS = range(1, 7)


def sender(root: Path, line: TcpLine | RtuLine) -> ModbusStopSender:
    assert isinstance(line, TcpLine)
    file = root / "config" / "drives" / "virtual-max100-modbus-tcp.yaml"
    content = yaml.safe_load(file.read_text("utf-8"))
    content["line"]["port"] = line.port
    profile = parse_profile(content, file.parent)
    return ModbusStopSender(profile, load_registers(profile.registers))


def test_every_unit_is_told_and_answers_that_come_late_count(root: Path) -> None:
    """The first unit answers once the fifth is told, together with that; the fourth refuses, the last is silent."""
    held = dict[int, bytes]()

    def spoil(request: Request, frame: bytes) -> bytes | None:
        match request.unit:
            case 1:
                held[1] = frame
                return None
            case 2:  # cut in the middle of its head
                held[2] = frame[5:]
                return frame[:5]
            case 3:
                return held[2] + frame
            case 5:
                return held[1] + frame
            case 6:
                return None
        return frame

    bank = Bank("tcp", {unit: {} if unit == 4 else dict(ANYTHING) for unit in UNITS}, spoil)
    with serving(bank) as line:
        told = sender(root, line).send()
    assert [request.unit for request in bank.requests][: len(UNITS)] == list(UNITS)
    assert {request.unit for request in bank.requests[len(UNITS) :]} == {6}  # told again, for it may not have heard
    assert {request.words[-1] for request in bank.requests} == {2}  # quick stop
    wrong = {"joint_4": "refused the stop", "joint_6": "did not answer"}
    assert told == dict.fromkeys((f"joint_{unit}" for unit in UNITS), "") | wrong


def test_a_line_that_the_drives_close_is_told(root: Path) -> None:
    with serving(Bank("tcp")) as line:
        closed = sender(root, line)
    with pytest.raises(ConnectionFailed, match=line.place):
        closed.send()


def test_a_unit_that_lost_its_request_to_another_that_was_slow_is_told_again(root: Path) -> None:
    heard = list[int]()

    def spoil(request: Request, frame: bytes) -> bytes | None:
        heard.append(request.unit)
        return None if request.unit == 3 and heard.count(3) == 1 else frame

    with serving(Bank("tcp", {unit: dict(ANYTHING) for unit in UNITS}, spoil)) as line:
        told = sender(root, line).send()
    assert heard[: len(UNITS)] == list(UNITS)
    assert set(heard[len(UNITS) :]) == {3}
    assert set(told.values()) == {""}
