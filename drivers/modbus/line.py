"""One Modbus line, TCP or RTU: one request at a time, and the last reception of every unit. Blocking.

A write is never repeated: it is unknown whether the drive executed it, and a motion command must not be sent twice.
A read that the drive answers by "busy" is repeated after `BUSY_PAUSES`. An RTU read is repeated once if the answer was
damaged, because then no answer is pending. After a time-out nothing
is repeated: an RTU answer does not show to which request it belongs. A unit that did not answer is lost. It is only
stopped, and not asked, until `due` lets the heartbeat look for it again; its late answers have then been discarded
with the buffer of the line. On TCP the transaction id identifies an answer, and the connection is opened again.

A stop goes before everything (`hurry`): the answer to a running request is awaited for `STOP_WAIT` at most, and no
request is made until the stops are written. For `STOP_TIME` after that a silent unit costs at most `STOP_TIMEOUT`.
"""

import logging
import struct
import threading
import time
from collections.abc import Callable, Sequence
from typing import NoReturn, Protocol

from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from drivers.cia402.thread import StopFirst
from drivers.errors import CommunicationLost, ConnectionFailed, Measured, WrongConfiguration
from drivers.modbus.client import Client, make_client, refusal
from drivers.modbus.profile import RtuLine, TcpLine

logger = logging.getLogger(__name__)

BEATS = 4  # requests to each unit within the watchdog time
LOOK_AGAIN = 2.0  # s between attempts to reach a lost unit
STOP_WAIT = 0.1  # s that a stop waits for the answer to a request before it; drives answer within 0.02 s
STOP_TIMEOUT = 0.5  # s for an answer while the machine is being stopped
STOP_TIME = 3.0  # s after a stop during which the machine is being stopped

BUSY_PAUSES = (0.01, 0.02, 0.04, 0.08, 0.16)  # s before a read is asked again; in all less than `STOP_TIMEOUT`

READ, WRITE = 3, 16  # function codes
BUSY = frozenset({5, 6})  # exceptions: the request is in process, or has to be asked again (Modbus V1.1b3, 7)
GATEWAY = frozenset({0x0A, 0x0B})  # exceptions of a gateway that cannot reach the unit
EXCEPTIONS = {
    1: "the drive does not know this function",
    2: "no such register",
    3: "the drive refuses the value",
    4: "the drive refuses in its present state",
    5: "the drive is still processing the request",
    6: "the drive is busy",
}
# pymodbus does not convert all errors of its decoders.
BROKEN = (ModbusException, OSError, struct.error, IndexError, ValueError)


class Clock(Protocol):
    """The module `time`, or another clock for a test."""

    def monotonic(self) -> float: ...

    def sleep(self, seconds: float, /) -> None: ...


class Line:
    """An open line. For one thread, except `hurry`."""

    def __init__(
        self,
        profile: TcpLine | RtuLine,
        clock: Clock = time,
        make: Callable[[TcpLine | RtuLine, Callable[[], float]], Client] = make_client,
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
        """Period of the heartbeat, s."""
        return self._profile.watchdog / BEATS

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
        hurried = self._sent < self._stopped + STOP_TIME
        until = self._sent + (min(self._profile.timeout, STOP_TIMEOUT) if hurried else self._profile.timeout)
        if self._stops:
            until = min(until, self._stopped + STOP_WAIT)
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
        except BROKEN as error:
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
        if now - self._lost[unit][0] < LOOK_AGAIN or self._in_use - self._lost.keys():
            return False
        del self._lost[unit]
        return True

    # -- inside --------------------------------------------------------------------------------------------------

    def _ask(self, unit: int, what: str, function: int, request: Callable[[], ModbusPDU]) -> ModbusPDU:
        response = self._answered(unit, what, function, request)
        for pause in BUSY_PAUSES:
            if function != READ or not response.isError() or response.exception_code not in BUSY:
                break
            self._clock.sleep(pause)
            response = self._answered(unit, what, function, request)
        if response.isError():
            meaning = EXCEPTIONS.get(response.exception_code, "refused")
            raise WrongConfiguration(f"{what}: Modbus exception {response.exception_code}: {meaning}")
        return response

    def _answered(self, unit: int, what: str, function: int, request: Callable[[], ModbusPDU]) -> ModbusPDU:
        self._require_open()
        if unit in self._lost:
            raise _lost(self._lost[unit][1])
        repeatable = function == READ and self._profile.transport == "rtu"
        try:
            response = self._exchange(unit, request)
        except BROKEN as error:
            if self._stops:
                self._leave(unit, what)
            if not (repeatable and self._client.garbled):
                self._lose(unit, f"{what}: {error}")
            logger.warning("%s: damaged answer, request repeated", what)
            try:
                response = self._exchange(unit, request)
            except BROKEN as again:
                self._lose(unit, f"{what}: {again}")
        if response.function_code & 0x7F != function or response.exception_code in GATEWAY:
            self._lose(unit, f"{what}: answered by {response}")
        if response.isError():
            self._heard[unit] = self._clock.monotonic()
        return response

    def _exchange(self, unit: int, request: Callable[[], ModbusPDU]) -> ModbusPDU:
        self._wait_for_silence()
        if self._stops:
            raise StopFirst(f"Modbus {self._profile.place}: a stop goes first")
        self._client.garbled = False
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
        reason = f"{what}: no answer within {STOP_WAIT} s of a stop"
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
