"""One Modbus line, TCP or RTU: one request at a time, and the last reception of every unit. Blocking.

A write is never repeated: it is unknown whether the drive executed it, and a motion command must not be sent twice.
An RTU read is repeated once if the answer was damaged, because then no answer is pending. After a time-out nothing
is repeated: an RTU answer does not show to which request it belongs. A unit that did not answer is lost. It is only
stopped, and not asked, until `due` lets the heartbeat look for it again; its late answers have then been discarded
with the buffer of the line. On TCP the transaction id identifies an answer, and the connection is opened again.
"""

import logging
import socket
import struct
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NoReturn, cast

import serial
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException
from pymodbus.pdu import ModbusPDU

from drivers.errors import CommunicationLost, ConnectionFailed, WrongConfiguration
from drivers.modbus.profile import RtuLine, TcpLine

logger = logging.getLogger(__name__)

BEATS = 4  # requests to each unit within the watchdog time
LOOK_AGAIN = 2.0  # s between attempts to reach a lost unit

READ, WRITE = 3, 16  # function codes
GATEWAY = frozenset({0x0A, 0x0B})  # exceptions of a gateway that cannot reach the unit
EXCEPTIONS = {
    1: "the drive does not know this function",
    2: "no such register",
    3: "the drive refuses the value",
    4: "the drive refuses in its present state",
    6: "the drive is busy",
}
# pymodbus does not convert all errors of its decoders.
BROKEN = (ModbusException, OSError, struct.error, IndexError, ValueError)


class Line:
    """An open line. For one thread."""

    def __init__(self, profile: TcpLine | RtuLine) -> None:
        self._profile = profile
        self._garbled = False
        self._client = self._make(profile)
        self._closed = True
        self._quiet_from = 0.0
        self._asked: dict[int, float] = {}
        self._heard: dict[int, float] = {}
        self._lost: dict[int, tuple[float, str]] = {}  # by unit: since when, and why
        self._in_use: set[int] = set()

    @property
    def beat(self) -> float:
        """Period of the heartbeat, s."""
        return self._profile.watchdog / BEATS

    def open(self) -> None:
        """Raises ConnectionFailed if the line cannot be opened."""
        self._closed = False
        if not self._client.connect():
            self._closed = True
            place = f"Modbus {self._profile.transport} {self._profile.place}"
            raise ConnectionFailed(
                f"{place} could not be opened: {_refusal(self._profile)}; check power, cable and address"
            )

    def close(self) -> None:
        """May be called twice."""
        self._closed = True
        self._client.close()

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
        self._heard[unit] = time.monotonic()
        return list(response.registers)

    def write(self, unit: int, address: int, registers: Sequence[int], what: str) -> None:
        """Errors as `read`. Always uses function 16, which every drive with two-register values supports."""
        response = self._ask(
            unit, what, WRITE, lambda: self._client.write_registers(address, list(registers), device_id=unit)
        )
        if (response.address, response.count) != (address, len(registers)):
            self._lose(unit, f"{what}: received the answer to another request")
        self._heard[unit] = time.monotonic()

    def tell(self, unit: int, address: int, registers: Sequence[int], what: str) -> None:
        """Write without waiting for an answer, to a lost unit as well.

        Never to unit 0, the broadcast: the line may have drives with another register map.
        """
        self._wait_for_silence()
        try:
            self._require_open()
            self._client.write_registers(address, list(registers), device_id=unit, no_response_expected=True)
        except BROKEN as error:
            raise CommunicationLost(f"{what}: {error}") from None
        finally:
            self._quiet_from = time.monotonic()

    # -- who is there --------------------------------------------------------------------------------------------

    def check(self, unit: int, what: str) -> None:
        """Raises CommunicationLost if the unit is lost, or was silent for longer than the watchdog time."""
        if unit in self._lost:
            raise CommunicationLost(self._lost[unit][1])
        silent = time.monotonic() - self._heard.get(unit, 0.0)
        if silent > self._profile.watchdog:
            raise CommunicationLost(f"{what}: no answer for {silent:.2f} s")

    def use(self, unit: int) -> None:
        """The unit may move from now on: lost units are not searched for."""
        self._in_use.add(unit)

    def release(self, unit: int) -> None:
        self._in_use.discard(unit)

    def due(self, unit: int) -> bool:
        """Whether the heartbeat should ask this unit now, because there was no other request recently. A lost unit is
        asked rarely, and only while no other unit is in use, because each attempt costs a time-out.
        """
        now = time.monotonic()
        if unit not in self._lost:
            return now - self._asked.get(unit, 0.0) > self.beat / 2
        if now - self._lost[unit][0] < LOOK_AGAIN or self._in_use - self._lost.keys():
            return False
        del self._lost[unit]
        return True

    # -- inside --------------------------------------------------------------------------------------------------

    def _ask(self, unit: int, what: str, function: int, request: Callable[[], ModbusPDU]) -> ModbusPDU:
        self._require_open()
        if unit in self._lost:
            raise CommunicationLost(self._lost[unit][1])
        repeatable = function == READ and self._profile.transport == "rtu"
        try:
            response = self._exchange(unit, request)
        except BROKEN as error:
            if not (repeatable and self._garbled):
                self._lose(unit, f"{what}: {error}")
            logger.warning("%s: damaged answer, request repeated", what)
            try:
                response = self._exchange(unit, request)
            except BROKEN as again:
                self._lose(unit, f"{what}: {again}")
        if response.function_code & 0x7F != function or response.exception_code in GATEWAY:
            self._lose(unit, f"{what}: answered by {response}")
        if response.isError():
            self._heard[unit] = time.monotonic()
            meaning = EXCEPTIONS.get(response.exception_code, "refused")
            raise WrongConfiguration(f"{what}: Modbus exception {response.exception_code}: {meaning}")
        return response

    def _exchange(self, unit: int, request: Callable[[], ModbusPDU]) -> ModbusPDU:
        self._wait_for_silence()
        self._garbled = False
        self._asked[unit] = time.monotonic()
        try:
            return request()
        finally:
            self._quiet_from = time.monotonic()

    def _wait_for_silence(self) -> None:
        time.sleep(max(0.0, self._quiet_from + self._profile.silence - time.monotonic()))

    def _require_open(self) -> None:
        if self._closed:  # pymodbus would reopen it by itself
            raise CommunicationLost(f"Modbus {self._profile.place}: closed")

    def _lose(self, unit: int, reason: str) -> NoReturn:
        """Raises CommunicationLost now, and at every request until the unit answers again."""
        logger.error("%s", reason)
        self._lost[unit] = (time.monotonic(), reason)
        if self._profile.transport == "tcp":  # the rest of an answer must not be read by the next request
            self._client.close()
        raise CommunicationLost(reason)

    def _make(self, profile: TcpLine | RtuLine) -> "ModbusTcpClient | SerialClient":
        if isinstance(profile, TcpLine):
            return ModbusTcpClient(profile.host, port=profile.port, timeout=profile.timeout, retries=0)
        return SerialClient(
            profile.device,
            baudrate=profile.baudrate,
            parity=profile.parity,
            stopbits=profile.stopbits,
            timeout=profile.timeout,
            retries=0,
            trace_packet=self._see,
        )

    def _see(self, sending: bool, data: bytes) -> bytes:
        """Bytes of an answer, valid or damaged."""
        self._garbled = self._garbled or not sending
        return data


def _refusal(profile: TcpLine | RtuLine) -> str:
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


class SerialClient(ModbusSerialClient):
    """pymodbus' client polls for bytes every millisecond until the wall clock passes the time-out. This one waits by
    the monotonic clock of pyserial, which is not affected when the clock is set.
    """

    def recv(self, size: int | None) -> bytes:
        """The received bytes, or the first byte within the time-out; empty after that. Raises ConnectionException."""
        port = cast(Any, self.socket)
        if port is None:
            raise ConnectionException(str(self))
        try:
            return bytes(port.read(size or max(1, port.in_waiting)))
        except OSError as error:
            with suppress(OSError):
                self.close()
            raise ConnectionException(f"{self}: {error}") from None
