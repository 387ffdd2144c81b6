"""A Modbus line in memory, on a clock that only moves when somebody waits: every request is counted, with its time."""

import heapq
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from itertools import count

from pymodbus.exceptions import ModbusIOException
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import ReadHoldingRegistersResponse, WriteMultipleRegistersResponse

from drivers.modbus.line import Client
from drivers.modbus.profile import RtuProfile, TcpProfile
from tests.unit.drivers.modbus_bank import Bank, Request

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
