"""Modbus drives for tests: on a real line whose answers may be spoilt, and in memory on a clock
that only moves when somebody waits.
"""

import heapq
import os
import pty
import select
import socket
import threading
import tty
from collections.abc import Callable, Collection, Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from pymodbus.exceptions import ModbusIOException
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import ReadHoldingRegistersResponse, WriteMultipleRegistersResponse

from drivers.cia402.host_watch import HostWatch
from drivers.modbus.line import Client
from drivers.modbus.profile import ModbusProfile, RtuProfile, TcpProfile, parse_profile
from drivers.modbus.registers import RegisterMap, load_registers
from drivers.modbus.unit import ControlToken
from drivers.registry import load_profile


@dataclass
class Request:
    unit: int
    function: int
    address: int
    count: int
    words: list[int]  # written


Spoil = Callable[[Request, bytes], bytes | None]


@dataclass
class Bank:
    """`registers` by unit; what is not there is exception 2. One thread serves until `serving` ends."""

    transport: str
    registers: dict[int, dict[int, int]] = field(default_factory=dict)
    spoil: Spoil = lambda _, frame: frame
    react: Callable[[Request], object] = lambda _: None  # to what was written, before the answer
    requests: list[Request] = field(default_factory=list)
    send: Callable[[bytes], object] = lambda _: None

    def writes(self, address: int) -> list[int]:
        """First words written there, in order."""
        return [request.words[0] for request in self.requests if request.function == 16 and request.address == address]

    def answer(self, request: Request) -> bytes:
        """The PDU."""
        registers = self.registers.get(request.unit, {})
        places = range(request.address, request.address + request.count)
        if any(place not in registers for place in places):
            return bytes([request.function | 0x80, 2])
        if request.function == 16:
            registers.update(zip(places, request.words, strict=True))
            self.react(request)
            return b"\x10" + request.address.to_bytes(2, "big") + request.count.to_bytes(2, "big")
        return bytes([3, 2 * request.count]) + b"".join(registers[place].to_bytes(2, "big") for place in places)

    def take(self, unit: int, pdu: bytes, frame: Callable[[int, bytes], bytes]) -> None:
        words = [int.from_bytes(pdu[k : k + 2], "big") for k in range(6, len(pdu), 2)]
        request = Request(unit, pdu[0], int.from_bytes(pdu[1:3], "big"), int.from_bytes(pdu[3:5], "big"), words)
        self.requests.append(request)
        reply = self.spoil(request, frame(unit, self.answer(request)))
        if reply:
            self.send(reply)


ANSWER = 2e-3  # s from a request to its answer


class Clock:
    """Seconds since it was made. What is to happen `at` a time happens while somebody waits past it."""

    def __init__(self) -> None:
        self.now = 0.0
        self._coming: list[tuple[float, int, Callable[[], object]]] = []
        self._number = count()

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float, /) -> None:
        end = self.now + seconds
        while self.now < end:
            self.step(end)
        self.now = end

    def at(self, when: float, what: Callable[[], object]) -> None:
        heapq.heappush(self._coming, (when, next(self._number), what))

    def step(self, end: float) -> None:
        """To `end`, or to what happens before."""
        if not self._coming or self._coming[0][0] > end:
            self.now = end
            return
        when, _, what = heapq.heappop(self._coming)
        self.now = max(self.now, when)
        what()


@dataclass
class Wire:
    """Units of a bank on a line; the `silent` ones hear and do not answer. `log`: time and request."""

    bank: Bank
    clock: Clock
    silent: Collection[int] = ()
    log: list[tuple[float, Request]] = field(default_factory=list)

    def __call__(self, _: TcpProfile | RtuProfile, left: Callable[[], float]) -> Client:
        return MemoryClient(self, left)


@dataclass
class MemoryClient:
    """See `drivers.modbus.line.Client`."""

    wire: Wire
    left: Callable[[], float]
    garbled: bool = False
    outdated: bool = False

    def connect(self) -> bool:
        return True

    def close(self) -> None:
        """Nothing is open."""

    def wake(self) -> None:
        """The clock looks itself."""

    def read_holding_registers(self, address: int, *, count: int, device_id: int) -> ModbusPDU:
        return self._ask(Request(device_id, 3, address, count, []))

    def write_registers(
        self, address: int, values: list[int], *, device_id: int, no_response_expected: bool = False
    ) -> ModbusPDU:
        return self._ask(Request(device_id, 16, address, len(values), list(values)), awaited=not no_response_expected)

    def _ask(self, request: Request, *, awaited: bool = True) -> ModbusPDU:
        wire, clock = self.wire, self.wire.clock
        wire.log.append((clock.now, request))
        pdu = wire.bank.answer(request)
        if awaited and request.unit in wire.silent:
            while (left := self.left()) > 0:
                clock.step(clock.now + left)
            raise ModbusIOException("no answer")
        if awaited:
            clock.sleep(ANSWER)
        if pdu[0] & 0x80:
            return ExceptionResponse(request.function, pdu[1])
        if request.function == 16:
            return WriteMultipleRegistersResponse(address=request.address, count=request.count)
        words = [int.from_bytes(pdu[k : k + 2], "big") for k in range(2, len(pdu), 2)]
        return ReadHoldingRegistersResponse(registers=words)


TIMEOUT = 0.1


"""The frame that really goes back, or None for silence."""


def crc(data: bytes) -> bytes:
    """Modbus over serial line V1.02, 6.2.2; low byte first."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value.to_bytes(2, "little")


def rtu_frame(unit: int, pdu: bytes) -> bytes:
    body = bytes([unit]) + pdu
    return body + crc(body)


def tcp_frame(transaction: int, unit: int, pdu: bytes) -> bytes:
    return transaction.to_bytes(2, "big") + b"\0\0" + (len(pdu) + 1).to_bytes(2, "big") + bytes([unit]) + pdu


@contextmanager
def serving(bank: Bank, timeout: float = TIMEOUT) -> Generator[TcpProfile | RtuProfile]:
    """The line that leads to the bank."""
    end = threading.Event()
    with _tcp(bank, end) if bank.transport == "tcp" else _rtu(bank, end) as place:
        if bank.transport == "tcp":
            yield TcpProfile(transport="tcp", host="127.0.0.1", port=int(place), timeout=timeout, watchdog=20 * timeout)
        else:
            # a pseudo-terminal has no parity
            yield RtuProfile(
                transport="rtu", device=place, baudrate=115200, parity="N", timeout=timeout, watchdog=20 * timeout
            )


@contextmanager
def _tcp(bank: Bank, end: threading.Event) -> Generator[str]:
    with socket.create_server(("127.0.0.1", 0)) as server, _thread(end, lambda: _serve_tcp(bank, server, end)):
        yield str(server.getsockname()[1])


def _serve_tcp(bank: Bank, server: socket.socket, end: threading.Event) -> None:
    while not end.is_set():
        if not select.select([server], [], [], 0.02)[0]:
            continue
        client, _ = server.accept()
        with client:
            bank.send = client.sendall
            _serve_client(bank, client, server, end)


def _serve_client(bank: Bank, client: socket.socket, server: socket.socket, end: threading.Event) -> None:
    buffer = b""
    while not end.is_set():
        ready = select.select([client, server], [], [], 0.02)[0]
        if client in ready:
            try:
                data = client.recv(4096)
            except OSError:
                return
            if not data:
                return
            buffer += data
            while len(buffer) >= 8 and len(buffer) >= (length := 6 + int.from_bytes(buffer[4:6], "big")):
                frame, buffer = buffer[:length], buffer[length:]
                transaction = int.from_bytes(frame[:2], "big")
                try:
                    bank.take(frame[6], frame[7:], lambda unit, pdu, t=transaction: tcp_frame(t, unit, pdu))
                except OSError:
                    return
        elif server in ready:  # a client comes anew when it gave the old connection up
            return


@contextmanager
def _rtu(bank: Bank, end: threading.Event) -> Generator[str]:
    near, far = pty.openpty()
    tty.setraw(near)
    tty.setraw(far)
    bank.send = lambda data: os.write(near, data)
    try:
        with _thread(end, lambda: _serve_rtu(bank, near, end)):
            yield os.ttyname(far)
    finally:
        os.close(near)
        os.close(far)


def _serve_rtu(bank: Bank, near: int, end: threading.Event) -> None:
    buffer = b""
    while not end.is_set():
        if select.select([near], [], [], 0.02)[0]:
            buffer += os.read(near, 4096)
        while len(buffer) >= 8 and len(buffer) >= (length := 8 if buffer[1] == 3 else 9 + buffer[6]):
            frame, buffer = buffer[:length], buffer[length:]
            if crc(frame[:-2]) == frame[-2:]:
                bank.take(frame[0], frame[1:-2] if frame[1] == 3 else frame[1:6] + frame[6:-2], rtu_frame)


@contextmanager
def _thread(end: threading.Event, serve: Callable[[], None]) -> Generator[None]:
    thread = threading.Thread(target=serve, name="modbus-bank")
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()


DRIVES = Path(__file__).parents[3] / "config" / "drives"
MAPS = DRIVES.parent / "registers"
HIGH, LOW = (load_registers(MAPS / f"virtual-{order}-first.yaml") for order in ("high", "low"))
STATES = {0x00: 0x40, 0x02: 0x40, 0x06: 0x21, 0x07: 0x23, 0x0F: 0x27}  # statusword after a controlword

KINDS = pytest.mark.parametrize(("kind", "registers"), [("tcp", HIGH), ("rtu", LOW)], ids=["tcp", "rtu"])


def nobody() -> ControlToken:
    """Of a line whose drives have no register for an owner."""
    return ControlToken((), HIGH, HostWatch(60.0), 0)


def drive(bank: Bank, registers: RegisterMap, unit: int, rated_torque: float) -> None:
    """A unit that has every register of the map, and follows its controlword and mode."""
    words = bank.registers.setdefault(unit, {})
    for signal in registers.signals.values():
        words |= dict.fromkeys(range(signal.address, signal.end), 0)
    trace = registers.trace
    assert trace is not None
    words |= dict.fromkeys(range(trace.address, trace.address + trace.registers), 0)
    contents = {"vendor": 0x5357, "product": 0x0402, "revision": 0x10000, "serial": 1000 + unit, "statusword": 0x40}
    contents |= {"constant": registers.constant}
    for name, value in (contents | {"rated_torque": rated_torque}).items():
        put(bank, registers, unit, name, value)


def put(bank: Bank, registers: RegisterMap, unit: int, name: str, value: float) -> None:
    signal = registers.signals[name]
    words = signal.format.encode(value)
    bank.registers[unit].update(zip(range(signal.address, signal.end), words, strict=False))


def get(bank: Bank, registers: RegisterMap, name: str, unit: int = 1) -> float:
    signal = registers.signals[name]
    return float(signal.format.decode([bank.registers[unit][k] for k in range(signal.address, signal.end)])[0])


def following(bank: Bank, registers: RegisterMap) -> None:
    def react(request: Request) -> None:
        if request.address == registers.signals["controlword"].address:
            controlword = int(get(bank, registers, "controlword", request.unit))
            put(bank, registers, request.unit, "statusword", STATES[controlword & 0xF])
        if request.address == registers.signals["mode"].address:
            put(bank, registers, request.unit, "mode_display", get(bank, registers, "mode", request.unit))

    bank.react = react


def profile_on(line: TcpProfile | RtuProfile, kind: str, axes: int = 1, **axis: Any) -> ModbusProfile:
    content = load_profile(DRIVES / f"virtual-max100-modbus-{kind}.yaml")
    all_axes: Any = content["axes"]
    content |= {
        "line": line.model_dump(),
        "travel_limits": {"rad": 1e3},
        "axes": [{**each, **axis} for each in all_axes[:axes]],
    }
    return parse_profile(content, DRIVES)
