"""The clients of a Modbus line, TCP and RTU: pymodbus' with a wait for the answer that another thread can shorten."""

import select
import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol, cast

import serial
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ConnectionException
from pymodbus.pdu import ModbusPDU

from drivers.modbus.profile import DIRECT, RtuLine, TcpLine


class Client(Protocol):
    """A Modbus client with pymodbus' names, and its errors. It awaits an answer as long as `left` is above 0."""

    garbled: bool
    """Bytes of an answer have come since this was set to False."""

    def connect(self) -> bool: ...

    def close(self) -> None: ...

    def wake(self) -> None:
        """The answer is awaited for a shorter time. From any thread."""
        ...

    def read_holding_registers(self, address: int, *, count: int, device_id: int) -> ModbusPDU: ...

    def write_registers(
        self, address: int, values: list[int], *, device_id: int, no_response_expected: bool = False
    ) -> ModbusPDU: ...


def refusal(profile: TcpLine | RtuLine) -> str:
    """Why there is no connection: pymodbus only logs it. Tried afterwards, because a drive may accept a single
    client.
    """
    try:
        if isinstance(profile, TcpLine):
            socket.create_connection((profile.host, profile.port), profile.timeout).close()
        else:
            serial.Serial(profile.device).close()
    except OSError as error:
        return error.strerror or str(error)
    return "the log has the reason"


def make_client(profile: TcpLine | RtuLine, left: Callable[[], float]) -> Client:
    """`left`: for how long the answer to the running request is awaited, s."""
    if isinstance(profile, TcpLine):
        return TcpClient(left, profile.host, port=profile.port, timeout=profile.timeout, retries=0)
    return SerialClient(
        left,
        profile.device,
        baudrate=profile.baudrate,
        parity=profile.parity,
        stopbits=profile.stopbits,
        timeout=profile.timeout,
        retries=0,
    )


class _Waiting:
    """Waits for bytes as long as an answer is awaited. pymodbus waits by the wall clock, and nothing shortens it."""

    def __init__(self, left: Callable[[], float]) -> None:
        self._left = left
        self._pair: tuple[socket.socket, socket.socket] | None = None

    def open(self) -> None:
        if self._pair is None:
            self._pair = socket.socketpair()
            self._pair[1].setblocking(False)

    def close(self) -> None:
        pair, self._pair = self._pair, None
        for end in pair or ():
            end.close()

    def wake(self) -> None:
        """See `Client.wake`."""
        pair = self._pair
        if pair is not None:
            with suppress(OSError):  # full: it wakes anyway; closed this moment: nobody waits
                pair[1].send(b"\0")

    def wait(self, port: Any) -> bool:
        """Whether there are bytes in time."""
        while self._pair is not None and (left := self._left()) > 0:
            ready = select.select([port, self._pair[0]], [], [], left)[0]
            if self._pair[0] in ready:
                self._pair[0].recv(4096)
            if port in ready:
                return True
        return False


class TcpClient(ModbusTcpClient):
    """pymodbus' client with the waiting of this module. `garbled`: bytes of an answer have come.

    A device that is addressed directly may answer with unit 0 or 255, whatever was asked (`DIRECT`); pymodbus would
    not take this for an answer. The transaction identifies it.
    """

    def __init__(self, left: Callable[[], float], host: str, **others: Any) -> None:
        super().__init__(host, trace_packet=self._as_asked, **others)
        self.garbled = False
        self._unit = 0
        self._waiting = _Waiting(left)
        self.wake = self._waiting.wake

    def _as_asked(self, sending: bool, data: bytes) -> bytes:
        """Frames of the line, in which answers of unit 0 and 255 have the unit that was asked."""
        if sending:
            self._unit = data[6]
            return data
        frames, at = bytearray(data), 6
        while at < len(frames):
            if frames[at] in DIRECT:
                frames[at] = self._unit
            at += 6 + int.from_bytes(frames[at - 2 : at], "big")
        return bytes(frames)

    def connect(self) -> bool:
        self._waiting.open()
        return bool(super().connect())

    def close(self) -> None:
        self._waiting.close()
        super().close()

    def recv(self, size: int | None) -> bytes:
        """The received bytes; empty if none came in time. Raises ConnectionException."""
        if self.socket is None:
            raise ConnectionException(str(self))
        if not self._waiting.wait(self.socket):
            return b""
        self.garbled = True
        data = self.socket.recv(size or 4096)
        if not data:
            self.close()
            raise ConnectionException(f"{self}: closed by the drives")
        return data


class SerialClient(ModbusSerialClient):
    """As `TcpClient`."""

    def __init__(self, left: Callable[[], float], port: str, **others: Any) -> None:
        super().__init__(port, **others)
        self.garbled = False
        self._waiting = _Waiting(left)
        self.wake = self._waiting.wake

    def connect(self) -> bool:
        self._waiting.open()
        return super().connect()

    def close(self) -> None:
        self._waiting.close()
        super().close()

    def recv(self, size: int | None) -> bytes:
        """As `TcpClient.recv`."""
        port = cast(Any, self.socket)
        if port is None:
            raise ConnectionException(str(self))
        try:
            if not self._waiting.wait(port):
                return b""
            self.garbled = True
            return bytes(port.read(size or max(1, port.in_waiting)))
        except OSError as error:
            with suppress(OSError):
                self.close()
            raise ConnectionException(f"{self}: {error}") from None
