"""The stop of Modbus TCP drives before units that answer at once, late, badly and never."""

import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml

from drivers.modbus import stop_sender
from drivers.modbus.profile import RtuProfile, TcpProfile, parse_profile
from drivers.modbus.registers import load_registers
from drivers.modbus.stop_sender import ModbusStopSender
from tests.unit.drivers.modbus_bank import HIGH, Bank, Request, drive, following, profile_on, put, serving, tcp_frame

ANYTHING = dict.fromkeys(range(0x10000), 0)
UNITS = range(1, 7)


def sender(root: Path, line: TcpProfile | RtuProfile) -> ModbusStopSender:
    assert isinstance(line, TcpProfile)
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


# -- confirmed


@contextmanager
def standing(root: Path) -> Generator[tuple[Bank, ModbusStopSender]]:
    """Six units that follow their controlwords."""
    bank = Bank("tcp")
    with serving(bank) as line:
        told = sender(root, line)
        for axis in profile_on(line, "tcp", axes=len(UNITS)).axes:
            drive(bank, HIGH, axis.unit_id, axis.rated_torque)
        following(bank, HIGH)
        yield bank, told


def test_standstill_without_energy_is_confirmed_and_nothing_is_written(root: Path) -> None:
    with standing(root) as (bank, told):
        assert set(told.send().values()) == {""}
        bank.requests.clear()
        assert told.confirm(5.0) == dict.fromkeys((f"joint_{unit}" for unit in UNITS), "")
    assert {request.function for request in bank.requests} == {3}


def test_what_moves_has_energy_or_is_silent_is_not_confirmed_in_time(root: Path) -> None:
    with standing(root) as (bank, told):
        put(bank, HIGH, 2, "statusword", 0x27)
        put(bank, HIGH, 3, "velocity", 100.0)
        put(bank, HIGH, 4, "statusword", 0x07)
        bank.spoil = lambda request, frame: None if request.unit in (1, 5) else frame
        begun = time.monotonic()
        found = told.confirm(1.0)
        assert time.monotonic() - begun < 1.2
    assert found["joint_6"] == ""
    assert found["joint_1"] == found["joint_5"] == "did not answer"
    assert found["joint_2"] == "reports 'operation enabled'"
    assert found["joint_3"].startswith("reports 0.0")
    assert found["joint_3"].endswith("rad/s")
    assert found["joint_4"] == "reports 'quick stop active'"


def test_what_a_unit_said_counts_if_there_was_no_time_to_answer_again(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stop_sender, "LATE_ANSWER", 10.0)
    with standing(root) as (bank, told):
        put(bank, HIGH, 1, "statusword", 0x27)
        asked: list[int] = []

        def spoil(request: Request, frame: bytes) -> bytes | None:
            asked.append(request.unit)
            return frame if asked.count(1) < 2 or request.unit != 1 else None

        bank.spoil = spoil
        assert told.confirm(2.0)["joint_1"] == "reports 'operation enabled'"
        assert asked.count(1) == 2


def test_no_answer_is_taken_for_that_of_another_unit_or_request(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Unit 1 moves; a gateway answers its requests with frames of unit 2 and of transactions before."""
    monkeypatch.setattr(stop_sender, "LATE_ANSWER", 10.0)  # no answer is late, however slow the computer is
    with standing(root) as (bank, told):
        put(bank, HIGH, 1, "statusword", 0x27)

        def spoil(request: Request, frame: bytes) -> bytes:
            if request.unit != 1:
                return frame
            good = bytes.fromhex("03 04 00000040")
            number = int.from_bytes(frame[:2], "big")
            return tcp_frame(number, 2, good) + tcp_frame(number - 1, 1, good) + frame

        bank.spoil = spoil
        assert told.confirm(2.0)["joint_1"] == "reports 'operation enabled'"
