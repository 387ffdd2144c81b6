"""One Modbus line, TCP or RTU: requests one after the other, and what was last heard of every unit. Blocking.

No write is ever repeated: whether the drive did it is not known, and a command of motion must not come twice. An RTU
read is asked once more if the answer came garbled, for then no answer is under way any more. A time-out is never
repeated: on RTU nothing in a late answer tells to which request it belongs. A unit that did not answer is lost: it is
left alone, except for stopping it, until `due` lets the heartbeat look for it again; what it said too late was then
thrown away with the line's buffer. On TCP the transaction id tells, and the connection is made anew.
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

BEATS = 4  # requests to each unit in a watchdog's time
LOOK_AGAIN = 2.0  # s between looks for a lost unit

READ, WRITE = 3, 16  # function codes
GATEWAY = frozenset({0x0A, 0x0B})  # exceptions by which a gateway says that the unit cannot be reached
EXCEPTIONS = {
    1: "the drive does not know this function",
    2: "no such register",
    3: "the drive refuses the value",
    4: "the drive refuses in its present state",
    6: "the drive is busy",
}
# pymodbus lets some of the errors of its decoders through.
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
        """ConnectionFailed where that is not possible."""
        self._closed = False
        if not self._client.connect():
            self._closed = True
            place = f"Modbus {self._profile.transport} {self._profile.place}"
            raise ConnectionFailed(f"{place} could not be opened: {_refusal(self._profile)}; is the machine on?")

    def close(self) -> None:
        """Safe to call twice."""
        self._closed = True
        self._client.close()

    # -- requests ------------------------------------------------------------------------------------------------

    def read(self, unit: int, address: int, count: int, what: str) -> list[int]:
        """`count` holding registers. `what` names them in errors.

        CommunicationLost where no answer comes, WrongConfiguration where the drive refuses.
        """
        response = self._ask(
            unit, what, READ, lambda: self._client.read_holding_registers(address, count=count, device_id=unit)
        )
        if len(response.registers) != count:
            self._lose(unit, f"{what}: {len(response.registers)} registers came instead of {count}")
        self._heard[unit] = time.monotonic()
        return list(response.registers)

    def write(self, unit: int, address: int, registers: Sequence[int], what: str) -> None:
        """As `read`. Function 16 whatever the number: every drive with values of two registers has it."""
        response = self._ask(
            unit, what, WRITE, lambda: self._client.write_registers(address, list(registers), device_id=unit)
        )
        if (response.address, response.count) != (address, len(registers)):
            self._lose(unit, f"{what}: the answer to another request came")
        self._heard[unit] = time.monotonic()

    def tell(self, unit: int, address: int, registers: Sequence[int], what: str) -> None:
        """Write without waiting for an answer, to a lost unit as well.

        Never to unit 0, which is everybody: the line may hold drives of which this map is not true.
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
        """CommunicationLost if the unit is lost, or was not heard for the time of the watchdog."""
        if unit in self._lost:
            raise CommunicationLost(self._lost[unit][1])
        silent = time.monotonic() - self._heard.get(unit, 0.0)
        if silent > self._profile.watchdog:
            raise CommunicationLost(f"{what}: no answer for {silent:.2f} s")

    def use(self, unit: int) -> None:
        """It may be moving from here on: no time for lost units."""
        self._in_use.add(unit)

    def release(self, unit: int) -> None:
        self._in_use.discard(unit)

    def due(self, unit: int) -> bool:
        """Whether the heartbeat should ask this unit now: nobody else did of late. Looks for a lost one rarely, and
        only while no other unit is in use, for that costs a time-out."""
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
            logger.warning("%s: garbled answer, asked once more", what)
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
        if self._closed:  # pymodbus would open it again by itself
            raise CommunicationLost(f"Modbus {self._profile.place}: closed")

    def _lose(self, unit: int, reason: str) -> NoReturn:
        """Raises CommunicationLost, now and at every request until the unit is found again."""
        logger.error("%s", reason)
        self._lost[unit] = (time.monotonic(), reason)
        if self._profile.transport == "tcp":  # no rest of an answer must meet the next request
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
        """Bytes of an answer, good or bad."""
        self._garbled = self._garbled or not sending
        return data


def _refusal(profile: TcpLine | RtuLine) -> str:
    """Why there is no connection: pymodbus only logs it. Asked afterwards, for a drive may take one client alone."""
    try:
        if isinstance(profile, TcpLine):
            socket.create_connection((profile.host, profile.port), profile.timeout).close()
        else:
            serial.Serial(profile.device).close()
    except OSError as error:
        return error.strerror or str(error)
    return "the log has the reason"


class SerialClient(ModbusSerialClient):
    """pymodbus' client looks for bytes every millisecond until the wall clock says that it is enough; this waits by
    pyserial's monotonic clock, which a set clock does not prolong."""

    def recv(self, size: int | None) -> bytes:
        """What is there, or the first byte within the time-out; empty after that. ConnectionException."""
        port = cast(Any, self.socket)
        if port is None:
            raise ConnectionException(str(self))
        try:
            return bytes(port.read(size or max(1, port.in_waiting)))
        except OSError as error:
            with suppress(OSError):
                self.close()
            raise ConnectionException(f"{self}: {error}") from None
