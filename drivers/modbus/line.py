"""One Modbus line, TCP or RTU: one request at a time, and the last reception of every unit. Blocking.

A write is never repeated: it is unknown whether the drive executed it, and a motion command must not be sent twice.
A read that the drive answers by "busy" is repeated up to five times. An RTU read is repeated once if the answer was
damaged, because then no answer is pending. After a time-out nothing is repeated: an RTU answer does not show to which
request it belongs. A unit that did not answer is lost. It is only stopped, and not asked, until `due` lets the
heartbeat look for it again; its late answers have then been discarded with the buffer of the line. On TCP the
transaction id identifies an answer, and the connection is opened again.

A stop goes before everything (`hurry`): the answer to a running request is awaited for `stop_wait` at most, and no
request is made until the stops are written. For `stop_time` after that a silent unit costs at most `stop_timeout`. One
behind which late answers to the stops come is slow, not silent: it has its whole time-out.
"""

import logging
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, NoReturn, Protocol, cast

import serial
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException
from pymodbus.framer import FramerRTU
from pymodbus.pdu import ModbusPDU

from drivers.cia402.connection import StopFirst
from drivers.errors import CommunicationLost, ConnectionFailed, Measured, WrongConfiguration
from drivers.modbus.profile import DIRECT, RtuProfile, TcpProfile

logger = logging.getLogger(__name__)

READ, WRITE = 3, 16  # function codes


class Client(Protocol):
    """A Modbus client with pymodbus' names, and its errors. It awaits an answer as long as `left` is above 0."""

    garbled: bool
    """Bytes of an answer have come since this was set to False."""
    outdated: bool
    """An answer to an earlier request has come since this was set to False."""

    def connect(self) -> bool: ...

    def close(self) -> None: ...

    def wake(self) -> None:
        """The answer is awaited for a shorter time. From any thread."""
        ...

    def read_holding_registers(self, address: int, *, count: int, device_id: int) -> ModbusPDU: ...

    def write_registers(
        self, address: int, values: list[int], *, device_id: int, no_response_expected: bool = False
    ) -> ModbusPDU: ...


def refusal(profile: TcpProfile | RtuProfile) -> str:
    """Why there is no connection: pymodbus only logs it. Tried afterwards: a drive may accept a single client."""
    try:
        if isinstance(profile, TcpProfile):
            socket.create_connection((profile.host, profile.port), profile.timeout).close()
        else:
            serial.Serial(profile.device).close()
    except OSError as error:
        return error.strerror or str(error)
    return "the log has the reason"


def make_client(profile: TcpProfile | RtuProfile, left: Callable[[], float]) -> Client:
    """`left`: for how long the answer to the running request is awaited, s."""
    if isinstance(profile, TcpProfile):
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


class _PatientClient:
    """pymodbus' client, which waits for bytes as long as an answer is awaited, `left`, s; alone it waits by the wall
    clock, and nothing shortens it. `garbled` and `outdated`: see `Client`.
    """

    garbled = outdated = False
    _pair: tuple[socket.socket, socket.socket] | None = None

    def __init__(self, left: Callable[[], float], place: str, **others: Any) -> None:
        self._left = left
        cast(Any, super()).__init__(place, **others)

    def connect(self) -> bool:
        if self._pair is None:
            self._pair = socket.socketpair()
            self._pair[1].setblocking(False)
        return bool(cast(Any, super()).connect())

    def close(self) -> None:
        pair, self._pair = self._pair, None
        for end in pair or ():
            end.close()
        cast(Any, super()).close()

    def wake(self) -> None:
        """See `Client.wake`."""
        pair = self._pair
        if pair is not None:
            with suppress(OSError):  # full: it wakes anyway; closed this moment: nobody waits
                pair[1].send(b"\0")

    def _bytes_come(self, port: Any) -> bool:
        """Whether there are bytes in time."""
        while self._pair is not None and (left := self._left()) > 0:
            ready = select.select([port, self._pair[0]], [], [], left)[0]
            if self._pair[0] in ready:
                self._pair[0].recv(4096)
            if port in ready:
                self.garbled = True
                return True
        return False


class TcpClient(_PatientClient, ModbusTcpClient):
    """A device that is addressed directly may answer with unit 0 or 255, whatever was asked (`DIRECT`); pymodbus would
    not take this for an answer. The transaction identifies it.
    """

    def __init__(self, left: Callable[[], float], host: str, **others: Any) -> None:
        super().__init__(left, host, trace_packet=self._as_asked, **others)
        self._unit = 0

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

    def recv(self, size: int | None) -> bytes:
        """The received bytes; empty if none came in time. Raises ConnectionException."""
        if self.socket is None:
            raise ConnectionException(str(self))
        if not self._bytes_come(self.socket):
            return b""
        data = self.socket.recv(size or 4096)
        if not data:
            self.close()
            raise ConnectionException(f"{self}: closed by the drives")
        return data


class SerialClient(_PatientClient, ModbusSerialClient):
    """A serial line. An answer shows neither its request nor its register: those that cannot belong to the running
    request are passed over, as the late ones to a stop, which nobody awaited. pymodbus would take one of another
    function, and drops with one of another unit all that came behind it.
    """

    _asked = b""  # the running request

    def send(self, request: bytes, addr: tuple[Any, ...] | None = None) -> int:
        self._asked = request
        return int(cast(Any, super()).send(request, addr))

    def recv(self, size: int | None) -> bytes:
        """As `TcpClient.recv`. Raises ModbusException too, if only answers to other requests came in time."""
        port, data, others = cast(Any, self.socket), b"", b""
        if port is None:
            raise ConnectionException(str(self))
        try:
            while self._bytes_come(port):
                data += port.read(max(1, port.in_waiting))
                while 0 < (length := _length(data)) <= len(data) and not _belongs(data[:length], self._asked):
                    others, data, self.outdated = others + data[:length], data[length:], True
                if length <= len(data):
                    break
        except OSError as error:
            with suppress(OSError):
                self.close()
            raise ConnectionException(f"{self}: {error}") from None
        if others and not data:
            self.garbled = False
            raise ModbusException(f"received the answer to another request, {others.hex(' ')}")
        return data


def _length(data: bytes) -> int:
    """Bytes of the RTU answer that begins here; more than there are while they do not tell it, 0 if none begins."""
    if len(data) < 3:
        return 3
    return {READ: 5 + data[2], WRITE: 8, READ | 0x80: 5, WRITE | 0x80: 5}.get(data[1], 0)


def _belongs(answer: bytes, request: bytes) -> bool:
    """Whether an RTU answer may be that to a request of `READ` or `WRITE`. A damaged one may."""
    body, crc = answer[:-2], int.from_bytes(answer[-2:], "big")
    if not FramerRTU.check_CRC(body, crc):
        return True
    same = (body[0], body[1] & 0x7F) == (request[0], request[1])
    if not same or body[1] & 0x80:
        return same
    return body[2:] == request[2:6] if body[1] == WRITE else body[2] == 2 * int.from_bytes(request[4:6], "big")


class Clock(Protocol):
    """The module `time`, or another clock for a test."""

    def monotonic(self) -> float: ...

    def sleep(self, seconds: float, /) -> None: ...


class MasterLine:
    """An open line. For one thread, except `hurry`."""

    # pymodbus does not convert all errors of its decoders.
    broken = (ModbusException, OSError, struct.error, IndexError, ValueError)

    look_again = 2.0  # s between attempts to reach a lost unit
    stop_wait = 0.1  # s that a stop waits for the answer to a request before it; drives answer within 0.02 s
    stop_timeout = 0.5  # s for an answer while the machine is being stopped
    stop_time = 3.0  # s after a stop during which the machine is being stopped
    busy_pauses = (0.01, 0.02, 0.04, 0.08, 0.16)  # s before a read is asked again; in all less than `stop_timeout`
    refusals: Mapping[int, str] = {
        1: "the drive does not know this function",
        2: "no such register",
        3: "the drive refuses the value",
        4: "the drive refuses in its present state",
        5: "the drive is still processing the request",
        6: "the drive is busy",
    }

    def __init__(
        self,
        profile: TcpProfile | RtuProfile,
        clock: Clock = time,
        make: Callable[[TcpProfile | RtuProfile, Callable[[], float]], Client] = make_client,
    ) -> None:
        """`make` returns the client; it gets for how long it awaits the answer to the running request, s."""
        self._profile = profile
        self._clock = clock
        self._client = make(profile, lambda: self.left)
        self._closed = True
        self._quiet_from = 0.0
        self._sent = 0.0  # the running request
        self._stops = 0  # that are not written yet
        self._stopped = float("-inf")  # when the first of them was ordered
        self._counting = threading.Lock()
        self._asked: dict[int, float] = {}
        self._heard: dict[int, float] = {}
        self._lost: dict[int, tuple[float, str]] = {}  # by unit: since when, and why
        self._in_use: set[int] = set()

    @property
    def beat(self) -> float:
        """Period of the heartbeat, s: four requests to each unit within the watchdog time."""
        return self._profile.watchdog / 4

    def open(self) -> None:
        """Raises ConnectionFailed if the line cannot be opened."""
        self._closed = False
        if not self._client.connect():
            self._closed = True
            place = f"Modbus {self._profile.transport} {self._profile.place}"
            raise ConnectionFailed(
                f"{place} could not be opened: {refusal(self._profile)}; check power, cable and address"
            )

    def close(self) -> None:
        """May be called twice."""
        self._closed = True
        self._client.close()

    # -- a stop --------------------------------------------------------------------------------------------------

    def hurry(self) -> None:
        """A stop is about to be told; `stopped` must follow. From any thread."""
        with self._counting:
            if not self._stops:  # a second stop does not give a silent unit more time
                self._stopped = self._clock.monotonic()
            self._stops += 1
        self._client.wake()

    def stopped(self) -> None:
        """A stop that was ordered by `hurry` is written."""
        with self._counting:
            self._stops -= 1

    @property
    def left(self) -> float:
        """For how long the answer to the running request is awaited, s. A stop shortens it."""
        hurried = self._sent < self._stopped + self.stop_time and not self._client.outdated
        until = self._sent + (min(self._profile.timeout, self.stop_timeout) if hurried else self._profile.timeout)
        if self._stops:
            until = min(until, self._stopped + self.stop_wait)
        return until - self._clock.monotonic()

    # -- requests ------------------------------------------------------------------------------------------------

    def read(self, unit: int, address: int, count: int, what: str) -> list[int]:
        """Read `count` holding registers. `what` names them in errors.

        Raises CommunicationLost if there is no answer, and WrongConfiguration if the drive refuses.
        """
        response = self._ask(
            unit, what, READ, lambda: self._client.read_holding_registers(address, count=count, device_id=unit)
        )
        if len(response.registers) != count:
            self._lose(unit, f"{what}: {len(response.registers)} registers came instead of {count}")
        self._heard[unit] = self._clock.monotonic()
        return list(response.registers)

    def write(self, unit: int, address: int, registers: Sequence[int], what: str) -> None:
        """Errors as `read`. Always uses function 16, which every drive with two-register values supports."""
        response = self._ask(
            unit, what, WRITE, lambda: self._client.write_registers(address, list(registers), device_id=unit)
        )
        if (response.address, response.count) != (address, len(registers)):
            self._lose(unit, f"{what}: received the answer to another request")
        self._heard[unit] = self._clock.monotonic()

    def tell(self, unit: int, address: int, registers: Sequence[int], what: str) -> None:
        """Write without waiting for an answer, to a lost unit as well. The next request waits until it has come.

        Never to unit 0, the broadcast: the line may have drives with another register map.
        """
        self._wait_for_silence()
        try:
            self._require_open()
            self._client.write_registers(address, list(registers), device_id=unit, no_response_expected=True)
        except MasterLine.broken as error:
            raise _lost(f"{what}: {error}") from None
        finally:
            self._quiet_from = self._clock.monotonic() + self._profile.answer_time  # nobody reads its answer

    # -- who is there --------------------------------------------------------------------------------------------

    def check(self, unit: int, what: str) -> None:
        """Raises CommunicationLost if the unit is lost, or was silent for longer than the watchdog time."""
        if unit in self._lost:
            raise _lost(self._lost[unit][1])
        silent = self._clock.monotonic() - self._heard.get(unit, 0.0)
        if silent > self._profile.watchdog:
            raise CommunicationLost(
                what, f"no answer for {silent:.2f} s", measured=Measured(silent, self._profile.watchdog, "s")
            )

    def in_use(self, unit: int) -> bool:
        """Whether the unit may move."""
        return unit in self._in_use

    def use(self, unit: int) -> None:
        """The unit may move from now on: lost units are not searched for."""
        self._in_use.add(unit)

    def release(self, unit: int) -> None:
        self._in_use.discard(unit)

    def due(self, unit: int) -> bool:
        """Whether the heartbeat should ask this unit now, because there was no other request recently. A lost unit is
        asked rarely, and only while no other unit is in use, because each attempt costs a time-out.
        """
        now = self._clock.monotonic()
        if unit not in self._lost:
            return now - self._asked.get(unit, 0.0) > self.beat / 2
        if now - self._lost[unit][0] < self.look_again or self._in_use - self._lost.keys():
            return False
        del self._lost[unit]
        return True

    # -- inside --------------------------------------------------------------------------------------------------

    def _ask(self, unit: int, what: str, function: int, request: Callable[[], ModbusPDU]) -> ModbusPDU:
        response = self._answered(unit, what, function, request)
        for pause in self.busy_pauses:
            if function != READ or not response.isError() or response.exception_code not in (5, 6):
                break
            self._clock.sleep(pause)
            response = self._answered(unit, what, function, request)
        if response.isError():
            meaning = self.refusals.get(response.exception_code, "refused")
            raise WrongConfiguration(f"{what}: Modbus exception {response.exception_code}: {meaning}")
        return response

    def _answered(self, unit: int, what: str, function: int, request: Callable[[], ModbusPDU]) -> ModbusPDU:
        self._require_open()
        if unit in self._lost:
            raise _lost(self._lost[unit][1])
        repeatable = function == READ and self._profile.transport == "rtu"
        try:
            response = self._exchange(unit, request)
        except MasterLine.broken as error:
            if self._stops:
                self._leave(unit, what)
            if not (repeatable and self._client.garbled):
                self._lose(unit, f"{what}: {error}")
            logger.warning("%s: damaged answer, request repeated", what)
            try:
                response = self._exchange(unit, request)
            except MasterLine.broken as again:
                self._lose(unit, f"{what}: {again}")
        if response.function_code & 0x7F != function or response.exception_code in (0x0A, 0x0B):  # gateway
            self._lose(unit, f"{what}: answered by {response}")
        if response.isError():
            self._heard[unit] = self._clock.monotonic()
        return response

    def _exchange(self, unit: int, request: Callable[[], ModbusPDU]) -> ModbusPDU:
        self._wait_for_silence()
        if self._stops:
            raise StopFirst(f"Modbus {self._profile.place}: a stop goes first")
        self._client.garbled = self._client.outdated = False
        self._asked[unit] = self._sent = self._clock.monotonic()
        try:
            return request()
        finally:
            self._quiet_from = self._clock.monotonic()

    def _wait_for_silence(self) -> None:
        self._clock.sleep(max(0.0, self._quiet_from + self._profile.silence - self._clock.monotonic()))

    def _require_open(self) -> None:
        if self._closed:  # pymodbus would reopen it by itself
            raise CommunicationLost(f"Modbus {self._profile.place}: closed")

    def _leave(self, unit: int, what: str) -> NoReturn:
        """A stop cannot wait for this answer any longer. On a serial line a late one could be taken for the next."""
        reason = f"{what}: no answer within {self.stop_wait} s of a stop"
        if self._profile.transport == "rtu":
            self._lost[unit] = (self._clock.monotonic(), reason)
        elif self._client.garbled:  # the rest must not be read by the next request
            self._client.close()
        logger.error("%s", reason)
        raise StopFirst(reason)

    def _lose(self, unit: int, reason: str) -> NoReturn:
        """Raises CommunicationLost now, and at every request until the unit answers again."""
        logger.error("%s", reason)
        self._lost[unit] = (self._clock.monotonic(), reason)
        if self._profile.transport == "tcp":  # the rest of an answer must not be read by the next request
            self._client.close()
        raise _lost(reason)


def _lost(reason: str) -> CommunicationLost:
    """`reason` begins with the axis, as `what` of each request does."""
    return CommunicationLost(*reason.split(": ", 1))
