"""Units with registers at the other end of a real line, TCP or a pseudo-terminal; their answers may be spoilt."""

import os
import pty
import select
import socket
import threading
import tty
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, field

from drivers.modbus.profile import RtuProfile, TcpProfile

TIMEOUT = 0.1


@dataclass
class Request:
    unit: int
    function: int
    address: int
    count: int
    words: list[int]  # written


Spoil = Callable[[Request, bytes], bytes | None]
"""The frame that really goes back, or None for silence."""


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
