"""Requests over a real line, TCP and RTU, to units that answer well, badly, late or never; the heartbeat."""

import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.contract.bench import eventually
from drivers.errors import CommunicationLost, ConnectionFailed, NotReady, WrongConfiguration
from drivers.modbus.fieldbus import ModbusConnection, ModbusFieldbus
from drivers.modbus.line import MasterLine
from drivers.modbus.profile import RtuProfile, TcpProfile
from drivers.modbus.registers import RegisterMap
from tests.unit.drivers.modbus_bank import (
    KINDS,
    TIMEOUT,
    Bank,
    Request,
    drive,
    following,
    profile_on,
    rtu_frame,
    serving,
)
from tests.unit.drivers.test_bus import soon

pytestmark = pytest.mark.slow

REGISTERS = {0x10: 0x1111, 0x11: 0x2222, 0x12: 0x3333}
PATIENCE = 1.0  # s for a good answer: line and units share this process, and the computer


@pytest.fixture(params=["tcp", "rtu"])
def bank(request: pytest.FixtureRequest) -> Bank:
    return Bank(request.param, {1: dict(REGISTERS), 2: dict(REGISTERS)})


@contextmanager
def opened(bank: Bank, timeout: float, **changes: float) -> Generator[MasterLine]:
    with serving(bank, timeout) as profile:
        line = MasterLine(profile.model_copy(update=changes))
        line.open()
        yield line
        line.close()


@pytest.fixture
def line(bank: Bank) -> Generator[MasterLine]:
    with opened(bank, PATIENCE) as line:
        yield line


@pytest.fixture
def hasty(bank: Bank) -> Generator[MasterLine]:
    """A line on which nobody answers well."""
    with opened(bank, TIMEOUT) as line:
        yield line


def test_a_refusal_is_no_loss(bank: Bank, line: MasterLine) -> None:
    with pytest.raises(WrongConfiguration, match=r"there: Modbus exception 2: no such register"):
        line.read(1, 0x99, 1, "there")
    with pytest.raises(WrongConfiguration):
        line.write(1, 0x99, [1], "there")
    assert line.read(1, 0x10, 1, "here") == [0x1111]


def test_silence_is_a_loss_at_once_and_until_it_is_found_again(
    bank: Bank, line: MasterLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MasterLine, "look_again", 0.0)
    bank.spoil = lambda request, frame: None if request.unit == 1 else frame
    with pytest.raises(CommunicationLost, match="unit 1 speed"):
        line.read(1, 0x10, 1, "unit 1 speed")
    asked = len(bank.requests)
    for attempt in (
        lambda: line.read(1, 0x10, 1, "x"),
        lambda: line.write(1, 0x10, [1], "x"),
        lambda: line.check(1, "x"),
    ):
        with pytest.raises(CommunicationLost, match="unit 1 speed"):
            attempt()
    assert len(bank.requests) == asked
    assert line.read(2, 0x10, 1, "the other") == [0x1111]
    line.use(2)
    assert not line.due(1)  # looking costs a time-out, and unit 2 may be moving
    line.release(2)
    bank.spoil = lambda _, frame: frame
    assert line.due(1)
    assert line.read(1, 0x10, 1, "found") == [0x1111]


def test_no_write_is_ever_repeated(bank: Bank, hasty: MasterLine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(MasterLine, "look_again", 0.0)

    def garbled(_: Request, frame: bytes) -> bytes:
        return b"\xff" * 9 if bank.transport == "tcp" else frame[:-1] + bytes([frame[-1] ^ 1])

    def silent(_: Request, __: bytes) -> None:
        """No answer."""

    for unit, spoil in ((1, silent), (2, garbled)):
        bank.spoil = spoil
        with pytest.raises(CommunicationLost):
            hasty.write(unit, 0x10, [5], "word")
    bank.spoil = lambda _, frame: frame
    assert hasty.due(1)
    assert hasty.read(1, 0x10, 1, "what stands there") == [5]  # a repetition would have come before this
    assert bank.writes(0x10) == [5, 5]


@pytest.mark.slow
@pytest.mark.parametrize("bank", ["rtu"], indirect=True)
def test_a_garbled_read_on_a_serial_line_is_asked_once_more(bank: Bank, line: MasterLine) -> None:
    def spoil_first(_: Request, frame: bytes) -> bytes:
        return frame[:-1] + bytes([frame[-1] ^ 1]) if len(bank.requests) == 1 else frame

    bank.spoil = spoil_first
    assert line.read(1, 0x10, 1, "noisy") == [0x1111]
    assert len(bank.requests) == 2
    bank.spoil = lambda _, frame: frame[:-1] + bytes([frame[-1] ^ 1])
    with pytest.raises(CommunicationLost):
        line.read(1, 0x10, 1, "noise")
    assert len(bank.requests) == 4


@pytest.mark.slow
def test_a_late_answer_is_never_taken_for_that_of_a_later_request(
    bank: Bank, line: MasterLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The unit's first two answers come after the time-out, each with the unit, function and length of the next."""
    monkeypatch.setattr(MasterLine, "look_again", 0.2)
    late: list[bytes] = []

    def hold_back(request: Request, frame: bytes) -> bytes | None:
        if request.unit == 2 or len(late) == 2:
            return frame
        late.append(frame)
        return None

    bank.spoil = hold_back
    for _ in range(2):
        soon(lambda: line.due(1))
        with pytest.raises(CommunicationLost):
            line.read(1, 0x10, 1, "late")
        assert line.read(2, 0x12, 1, "meanwhile") == [0x3333]
        bank.send(late[-1])
    soon(lambda: line.due(1))
    assert line.read(1, 0x11, 1, "next") == [0x2222]


def answer(bank: Bank, unit: int, pdu: bytes) -> None:
    """To every request from now on."""
    if bank.transport == "rtu":
        bank.spoil = lambda _r, _f: rtu_frame(unit, pdu)
    else:
        bank.spoil = lambda _r, frame: frame[:4] + (len(pdu) + 1).to_bytes(2, "big") + bytes([unit]) + pdu


LATE = [  # what comes before the answer to a read of one register of unit 1
    [(1, b"\x10\x05\x00\x00\x01")],  # to its stop
    [(2, b"\x10\x05\x00\x00\x01"), (1, b"\x10\x05\x00\x00\x01")],
    [(2, b"\x03\x02\x00\x07"), (1, b"\x03\x04\x00\x07\x00\x07"), (1, b"\x90\x04")],
]


@pytest.mark.parametrize("bank", ["rtu"], indirect=True)
@pytest.mark.parametrize("pause", [0.0, 0.1])
@pytest.mark.parametrize("late", LATE)
def test_late_answers_to_a_stop_are_passed_over(
    late: list[tuple[int, bytes]], pause: float, bank: Bank, line: MasterLine
) -> None:
    """At once with the answer that is awaited, or before it; in pieces too."""
    frames = b"".join(rtu_frame(unit, pdu) for unit, pdu in late)

    def spoil(_: Request, frame: bytes) -> bytes:
        if not pause:
            return frames + frame
        for at in range(0, len(frames), 5):
            bank.send(frames[at : at + 5])
            time.sleep(pause)
        bank.send(frame[:4])
        time.sleep(pause)
        return frame[4:]

    bank.spoil = spoil
    assert line.read(1, 0x10, 1, "statusword") == [0x1111]
    bank.spoil = lambda _, frame: rtu_frame(*late[0]) + frame
    line.write(1, 0x11, [7], "word")
    assert len(bank.requests) == 2


@pytest.mark.parametrize("bank", ["rtu"], indirect=True)
@pytest.mark.parametrize("late", LATE)
def test_a_slow_unit_is_not_silent_while_late_answers_to_a_stop_come(
    late: list[tuple[int, bytes]], bank: Bank, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MasterLine, "stop_timeout", 0.2)

    def spoil(_: Request, frame: bytes) -> bytes:
        for unit, pdu in late:
            bank.send(rtu_frame(unit, pdu))
        time.sleep(0.4)
        return frame

    with opened(bank, 3 * PATIENCE) as line:
        line.hurry()
        line.stopped()
        bank.spoil = spoil
        assert line.read(1, 0x10, 1, "statusword") == [0x1111]
        bank.spoil = lambda _, __: None
        before = time.monotonic()
        with pytest.raises(CommunicationLost):
            line.read(2, 0x10, 1, "statusword")
        assert time.monotonic() - before < 3 * PATIENCE


def test_answers_of_somebody_else_are_no_answers(
    bank: Bank, hasty: MasterLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another unit, another function, another length."""
    monkeypatch.setattr(MasterLine, "look_again", 0.0)
    for number, (unit, pdu) in enumerate(
        [
            (2, b"\x03\x02\x00\x07"),
            (1, b"\x04\x02\x00\x07"),
            (1, b"\x03\x04\x00\x07\x00\x07"),
            (1, b"\x03\x00"),
            (1, b"\x83\x0b"),  # a gateway whose unit is away
            (1, b"\x10\x00\x10\x00\x01"),
        ]
    ):
        answer(bank, unit, pdu)
        assert hasty.due(1)  # was it lost by the one before, it is looked for again
        with pytest.raises(CommunicationLost):
            hasty.read(1, 0x10, 1, f"read {number}")


@pytest.mark.parametrize("sender", [0, 255, 2])
def test_a_tcp_drive_may_answer_as_unit_0_or_255(sender: int, bank: Bank, hasty: MasterLine) -> None:
    """The transaction identifies the answer; on a serial line, and from another unit, it is none."""
    place = 6 if bank.transport == "tcp" else 0
    bank.spoil = lambda _, frame: frame[:place] + bytes([sender]) + frame[place + 1 :]
    if bank.transport == "tcp" and sender != 2:
        assert hasty.read(1, 0x10, 2, "x") == [0x1111, 0x2222]
        hasty.write(1, 0x10, [3], "x")
    else:
        with pytest.raises(CommunicationLost):
            hasty.read(1, 0x10, 2, "x")


@pytest.mark.parametrize("code", [5, 6])
@pytest.mark.parametrize("times", [1, 5, 6])
def test_a_read_that_meets_a_busy_drive_is_repeated(code: int, times: int, bank: Bank, line: MasterLine) -> None:
    def spoil(request: Request, frame: bytes) -> bytes:
        if len(bank.requests) > times:
            return frame
        pdu = bytes([request.function | 0x80, code])
        return frame[:4] + b"\0\x03" + frame[6:7] + pdu if bank.transport == "tcp" else rtu_frame(request.unit, pdu)

    bank.spoil = spoil
    if times <= len(MasterLine.busy_pauses):
        assert line.read(1, 0x10, 1, "x") == [0x1111]
    else:
        with pytest.raises(WrongConfiguration, match=f"x: Modbus exception {code}: the drive is"):
            line.read(1, 0x10, 1, "x")
    assert len(bank.requests) == min(times, len(MasterLine.busy_pauses)) + 1
    bank.requests.clear()
    with pytest.raises(WrongConfiguration, match=f"exception {code}"):
        line.write(1, 0x10, [1], "no write is repeated")
    assert len(bank.requests) == 1


def test_the_answer_to_a_write_elsewhere_is_no_answer(bank: Bank, line: MasterLine) -> None:
    answer(bank, 1, b"\x10\x00\x11\x00\x01")
    with pytest.raises(CommunicationLost, match="another request"):
        line.write(1, 0x10, [1], "write")


def test_the_silence_between_frames_is_kept() -> None:
    with opened(Bank("rtu", {1: dict(REGISTERS)}), PATIENCE, silence_between_frames=0.03) as line:
        start = time.monotonic()
        for _ in range(5):
            line.read(1, 0x10, 1, "x")
        assert time.monotonic() - start >= 4 * 0.03


def test_a_line_that_is_closed(bank: Bank, line: MasterLine) -> None:
    line.close()
    line.close()
    with pytest.raises(CommunicationLost, match="closed"):
        line.read(1, 0x10, 1, "x")
    with pytest.raises(CommunicationLost, match="closed"):
        line.tell(1, 0x10, [1], "x")
    assert bank.requests == []


REFUSED = {  # where the line leads, and what the operating system says
    "nobody listens": ("127.0.0.1", r"127\.0\.0\.1:1 could not be opened: Connection refused"),
    "the name is no host": ("cabinet.invalid", r"cabinet\.invalid:1 could not be opened: .*(resol|know|service)"),
    "there is no such device": ("nowhere", "nowhere could not be opened: .*No such file or directory.*"),
    "the device is no serial line": ("file", "file could not be opened: .*Inappropriate ioctl.*"),
}


@pytest.mark.parametrize(("place", "told"), REFUSED.values(), ids=REFUSED)
def test_a_line_that_cannot_be_opened_says_why(place: str, told: str, tmp_path: Path) -> None:
    """For whoever forgot to switch the machine on."""
    (tmp_path / "file").touch()
    line: TcpProfile | RtuProfile = RtuProfile(transport="rtu", device=str(tmp_path / place), timeout=1.0, watchdog=4.0)
    if "." in place:
        line = TcpProfile(transport="tcp", host=place, port=1, timeout=1.0, watchdog=4.0)
    with pytest.raises(ConnectionFailed, match=f"{told}.*; check power, cable and address"):
        MasterLine(line).open()


@KINDS
async def test_the_heartbeat_speaks_to_every_unit_and_notices_a_loss(
    kind: str, registers: RegisterMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MasterLine, "look_again", 0.3)
    bank = Bank(kind)
    for unit, torque in ((1, 17.544), (2, 18.717)):
        drive(bank, registers, unit, torque)
    following(bank, registers)
    with serving(bank, PATIENCE) as served:
        served = served.model_copy(update={"watchdog": 2 * PATIENCE})
        connection = await ModbusFieldbus(profile_on(served, kind, axes=2)).open()
        with pytest.raises(NotReady, match="not possible through Modbus"):
            await connection.stream([], threading.Event())
        bank.requests.clear()
        await eventually(lambda: all([r.unit for r in bank.requests].count(unit) > 3 for unit in (1, 2)))
        bank.spoil = lambda request, frame: None if request.unit == 2 else frame
        await eventually(lambda: _lost(connection, "joint_2") and not _lost(connection, "joint_1"))
        bank.spoil = lambda _, frame: frame
        await eventually(lambda: not _lost(connection, "joint_2"))
        await connection.close()


def _lost(connection: ModbusConnection, joint: str) -> bool:
    try:
        connection.axes[joint].device.check_alive()
    except CommunicationLost:
        return True
    return False
