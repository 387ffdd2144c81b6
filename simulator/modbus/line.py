"""The cabinet on its Modbus line: TCP, a serial device, or a pseudo-terminal created here.

The drive cabinet on a Modbus line: requests and times are its only inputs, responses its only outputs.
"""

import asyncio
import contextlib
import math
import os
import selectors
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from math import inf
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple, cast

from pymodbus.constants import ExcCodes
from pymodbus.datastore import ModbusServerContext
from pymodbus.exceptions import NoSuchIdException
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.mei_message import ReadDeviceInformationRequest, ReadDeviceInformationResponse
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    ReadInputRegistersRequest,
    ReadInputRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteMultipleRegistersResponse,
    WriteSingleRegisterRequest,
    WriteSingleRegisterResponse,
)
from pymodbus.server import ModbusBaseServer, ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from simulator.cabinet import VirtualDriveCabinet
from simulator.drive.dictionary import AbortCode, ObjectDictionary, SdoAbort
from simulator.drive.makers import Key
from simulator.drive.power_drive import Mode
from simulator.drive.virtual_axis import VirtualAxis
from simulator.machine import LiveMachine
from simulator.modbus.registers import OWNER, SIGNALS, WATCHDOG, MappedSignal, RegisterLayout, factor, page_registers

_EXCEPTIONS = {
    AbortCode.NO_OBJECT: ExcCodes.ILLEGAL_ADDRESS,
    AbortCode.NO_SUBINDEX: ExcCodes.ILLEGAL_ADDRESS,
    AbortCode.READ_ONLY: ExcCodes.ILLEGAL_ADDRESS,
    AbortCode.WRITE_ONLY: ExcCodes.ILLEGAL_ADDRESS,
    AbortCode.STATE: ExcCodes.DEVICE_FAILURE,
    AbortCode.NO_DATA: ExcCodes.DEVICE_FAILURE,
}  # every other abort concerns the value


class Refusal(Exception):
    """A request that the unit answers with an exception response."""

    def __init__(self, code: ExcCodes) -> None:
        super().__init__(f"Modbus exception {code:d} {code.name}")
        self.code = code


class _Element(NamedTuple):
    """One value in registers: of a signal, or of an array's element."""

    signal: str
    number: int
    wire: MappedSignal


class ModbusUnit:
    """The node of an axis. All calls are made in the owner's thread."""

    def __init__(self, number: int, eds: Path, registers: RegisterLayout, cycle: float, *, can_move: bool) -> None:
        self.number = number
        self.dictionary = ObjectDictionary(eds, number)
        self.dictionary.nameplate[0x2110, 2] = min(registers.trace.capacity, self.dictionary[0x2110, 2])
        self.dictionary.on_download((0x2110, 2), self._check_page_count)
        self.axis = VirtualAxis(self.dictionary, cycle, can_move=can_move)
        self.disturbance = self.axis.disturbance
        self._map = registers
        self._at = {
            signal.address + element * signal.registers: _Element(name, element, signal)
            for name, signal in registers.signals.items()
            for element in range(signal.count)
        }
        self._watchdog = 0.0  # ms, 0 = off
        self._heard: float | None = None
        self._owner, self._owned = 0, 0.0  # token, 0: nobody; and the last time that it was written, s

    def renumber(self, number: int) -> None:
        """Change the unit id, as by its address switches: the unit boots with it. The device itself stays the same."""
        self.number = number
        self.boot()

    def boot(self) -> None:
        """Power-on or reset: torque off, dictionary as in EDS and nameplate, no watchdog."""
        self.dictionary.restore()
        self.axis.reset()
        self._watchdog, self._heard = 0.0, None
        self._owner = 0

    def hear(self, now: float) -> None:
        """A request for this unit arrived at `now`, s."""
        self._heard = now
        lapsed = self._watchdog > 0 and now > self._owned + self._watchdog * 1e-3
        if lapsed and not self.axis.energised:  # otherwise the axis has lost its host first
            self._owner = 0

    def run(self, now: float) -> None:
        """Check the watchdog at `now`, s."""
        if now > self.due(now):
            self._heard = None
            self.axis.lose_host()
        self.axis.errors.take_messages()  # Modbus has no unsolicited messages; the error is read as error_code

    def due(self, now: float) -> float:
        """Time at which the watchdog expires, s; infinity if it is off."""
        del now
        if self._watchdog <= 0 or not self.axis.energised or self._heard is None:
            return math.inf
        last = min(self._heard, self._owned) if self._owner else self._heard  # another host keeps no owner alive
        return last + self._watchdog * 1e-3

    # Registers

    def read(self, address: int, count: int) -> list[int]:
        """Read whole values, or any part of the page. Raises Refusal."""
        if not 1 <= count <= self._map.max_read:
            raise Refusal(ExcCodes.ILLEGAL_VALUE)
        order, trace = self._map.word_order, self._map.trace
        offset = address - trace.page.address
        if offset >= 0 and offset + count <= trace.page.registers:
            return page_registers(self._page(), trace, order, offset, count)
        registers: list[int] = []
        for element in self._elements(address, count):
            registers += element.wire.encode(self._get(element), order)
        return registers

    def write(self, address: int, registers: Sequence[int]) -> None:
        """Write whole values in order of the address; values before a refused one are written. Raises Refusal."""
        elements = self._elements(address, len(registers))
        if any(element.wire.access == "ro" for element in elements):
            raise Refusal(ExcCodes.ILLEGAL_ADDRESS)
        start = 0
        for element in elements:
            end = start + element.wire.registers
            self._set(element, element.wire.decode(registers[start:end], self._map.word_order))
            start = end

    def identification(self) -> dict[int, str]:
        """Objects of function 43/14: vendor, product, revision as 8 hexadecimal digits; 80h: the serial number."""
        subs = {0x00: 1, 0x01: 2, 0x02: 3, 0x80: 4}
        return {number: f"{self.dictionary[0x1018, sub]:08X}" for number, sub in subs.items()}

    def _elements(self, address: int, count: int) -> list[_Element]:
        """The values in these registers. Values must not be cut at either end, and unknown registers are refused."""
        elements: list[_Element] = []
        end = address + count
        while address < end:
            element = self._at.get(address)
            if element is None or address + element.wire.registers > end:
                raise Refusal(ExcCodes.ILLEGAL_ADDRESS)
            elements.append(element)
            address += element.wire.registers
        return elements

    def _get(self, element: _Element) -> float:
        """The value in the unit of its signal."""
        key = _key(element)
        if key is None:
            held = {WATCHDOG: self._watchdog, OWNER: float(self._owner)}
            return held.get(element.signal, float(element.wire.value or 0))
        try:
            data = self.dictionary.upload(*key)
        except SdoAbort as abort:
            raise Refusal(_EXCEPTIONS.get(abort.code, ExcCodes.ILLEGAL_VALUE)) from None
        (value,) = struct.unpack("<" + self.dictionary.struct_format(key), data)
        return value * factor(self.dictionary, key)

    def _set(self, element: _Element, value: float) -> None:
        """Write a value in the unit of its signal to the dictionary."""
        key = _key(element)
        try:
            if element.signal == OWNER:
                self._own(round(value))
                return
            if key is None:
                self._watchdog = float(round(value))
                return
            if key not in self.dictionary:
                raise SdoAbort(AbortCode.NO_OBJECT)
            kind = self.dictionary.struct_format(key)
            raw = value if kind in "fd" else round(value / factor(self.dictionary, key))
            if key == (0x6060, 0) and raw == Mode.CYCLIC_VELOCITY:  # cannot be streamed through Modbus
                raise SdoAbort(AbortCode.VALUE)
            self.dictionary.download(*key, struct.pack("<" + kind, raw))
        except SdoAbort as abort:
            raise Refusal(_EXCEPTIONS.get(abort.code, ExcCodes.ILLEGAL_VALUE)) from None
        except (ValueError, OverflowError, struct.error):  # NaN, infinity, wider than the object
            raise Refusal(ExcCodes.ILLEGAL_VALUE) from None

    def _own(self, token: int) -> None:
        """0 releases. Abort if another token has the unit."""
        if token and self._owner not in (0, token):
            raise SdoAbort(AbortCode.STATE)
        self._owner, self._owned = token, self._heard or 0.0

    def _page(self) -> bytes:
        """The samples from page_first on, as far as they are recorded."""
        try:
            return self.dictionary.upload(0x2110, 3)
        except SdoAbort as abort:
            if abort.code == AbortCode.NO_DATA:
                return b""
            raise Refusal(_EXCEPTIONS.get(abort.code, ExcCodes.ILLEGAL_VALUE)) from None

    def _check_page_count(self, value: int) -> None:
        if value > self._map.trace.capacity:
            raise SdoAbort(AbortCode.TOO_HIGH)


def _key(element: _Element) -> Key | None:
    key = SIGNALS[element.signal].key
    return None if key is None else (key[0], key[1] + element.number)


class ModbusCabinet(VirtualDriveCabinet[ModbusUnit]):
    """Unit ids 1, 2, ... in the order of the machine's joints."""

    def __init__(self, machine: LiveMachine, eds: Path, registers: RegisterLayout, speed_factor: float) -> None:
        units = {
            info.joint: ModbusUnit(number, eds, registers, machine.cycle, can_move=not info.locked)
            for number, info in enumerate(machine.axes, 1)
        }
        super().__init__(machine, units, speed_factor)

    def answer(self, request: ModbusPDU, now: float) -> ModbusPDU | None:
        """The response to a request at `now`, s of a monotonic clock; None if no unit answers."""
        unit = next((unit for unit in self.nodes.values() if unit.number == request.dev_id), None)
        if unit is None:
            return None
        unit.hear(now)
        try:
            response = _carry_out(unit, request)
        except Refusal as refusal:
            response = ExceptionResponse(request.function_code, refusal.code)
        self.switch()
        return None if unit.disturbance.mute else response


def _carry_out(unit: ModbusUnit, request: ModbusPDU) -> ModbusPDU:
    match request:
        case ReadInputRegistersRequest():
            return ReadInputRegistersResponse(registers=unit.read(request.address, request.count))
        case ReadHoldingRegistersRequest():
            return ReadHoldingRegistersResponse(registers=unit.read(request.address, request.count))
        case WriteSingleRegisterRequest():
            unit.write(request.address, request.registers)
            return WriteSingleRegisterResponse(address=request.address, registers=request.registers)
        case WriteMultipleRegistersRequest():
            if not 1 <= request.count == len(request.registers) <= 123 or request.byte_count != 2 * request.count:
                raise Refusal(ExcCodes.ILLEGAL_VALUE)
            unit.write(request.address, request.registers)
            return WriteMultipleRegistersResponse(address=request.address, count=request.count)
        case ReadDeviceInformationRequest():
            return _identify(unit, request)
        case _:
            raise Refusal(ExcCodes.ILLEGAL_FUNCTION)


def _identify(unit: ModbusUnit, request: ReadDeviceInformationRequest) -> ModbusPDU:
    """Read codes: 1 basic and 2 regular objects, 3 all, 4 a single one."""
    objects = unit.identification()
    match request.read_code:
        case 1 | 2:
            chosen = {number: text for number, text in objects.items() if request.object_id <= number < 0x80}
        case 3:
            chosen = {number: text for number, text in objects.items() if request.object_id <= number}
        case 4:
            chosen = {number: text for number, text in objects.items() if request.object_id == number}
        case _:
            raise Refusal(ExcCodes.ILLEGAL_VALUE)
    if not chosen:
        raise Refusal(ExcCodes.ILLEGAL_ADDRESS)
    return ReadDeviceInformationResponse(read_code=request.read_code, information=chosen)


class PtyPair:
    """Bytes written to `near` can be read from `far` and vice versa, transferred by the owner's selector.

    Data is lost if the reader leaves the terminal's buffer full, as on any serial line.
    """

    def __init__(self, selector: selectors.BaseSelector) -> None:
        self._selector = selector
        near, self._near_end = os.openpty()
        far, self._far_end = os.openpty()  # ends stay open here: a master without an open slave is an error
        self.near, self.far = os.ttyname(self._near_end), os.ttyname(self._far_end)
        self._masters = (near, far)
        for source, sink in ((near, far), (far, near)):
            os.set_blocking(source, False)
            selector.register(source, selectors.EVENT_READ, partial(self._carry, source, sink))

    def close(self) -> None:
        for master in self._masters:
            self._selector.unregister(master)
        for end in (*self._masters, self._near_end, self._far_end):
            os.close(end)

    @staticmethod
    def _carry(source: int, sink: int, _: int) -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(sink, os.read(source, 4096))


Answer = Callable[[ModbusPDU], ModbusPDU | None]
"""A response, or None for no answer."""


@dataclass(frozen=True, slots=True)
class TcpLine:
    """A listening port; 0: a free one."""

    host: str
    port: int


@dataclass(frozen=True, slots=True)
class SerialLine:
    """A serial device, 8 data bits, no parity, 1 stop bit."""

    device: str
    baudrate: int = 115200


class ModbusServer:
    """Serves until `close`. Raises OSError if the line cannot be opened."""

    def __init__(self, selector: selectors.BaseSelector, line: TcpLine | SerialLine, answer: Answer) -> None:
        self._selector = selector
        self._answer = answer
        self._asked: deque[tuple[ModbusPDU, Future[ModbusPDU | None]]] = deque()
        self._wake, self._woken = socket.socketpair()
        selector.register(self._woken, selectors.EVENT_READ, self._deliver)
        opened: Future[tuple[int | None, Callable[[], None]]] = Future()
        self._thread = Thread(target=lambda: asyncio.run(self._serve(line, opened)), name=f"modbus {line}")
        self._thread.start()
        try:
            self.port, self._end = opened.result()
        except OSError:
            self._release()
            raise

    def close(self) -> None:
        """Disconnect every client and close the line."""
        self._end()
        self._release()

    def _release(self) -> None:
        self._thread.join()
        self._selector.unregister(self._woken)
        self._woken.close()
        self._wake.close()

    # In the thread of the server

    async def _serve(self, line: TcpLine | SerialLine, opened: Future[tuple[int | None, Callable[[], None]]]) -> None:
        ended = asyncio.Event()
        loop = asyncio.get_running_loop()
        server = self._server(line)
        try:
            await server.serve_forever(background=True)
        except (RuntimeError, ValueError):  # pymodbus raises RuntimeError for any failure to listen
            opened.set_exception(OSError(f"{line}: cannot be opened"))
            return
        sockets = cast(Any, server.transport).sockets if isinstance(line, TcpLine) else ()
        port = int(sockets[0].getsockname()[1]) if sockets else None
        opened.set_result((port, lambda: cast(None, loop.call_soon_threadsafe(ended.set))))
        await ended.wait()
        await server.shutdown()

    def _server(self, line: TcpLine | SerialLine) -> ModbusBaseServer:
        nothing = SimDevice(0, SimData(0, datatype=DataType.REGISTERS))
        if isinstance(line, TcpLine):
            return ModbusTcpServer(
                nothing, address=(line.host, line.port), ignore_missing_devices=True, trace_pdu=self._intercept
            )
        return ModbusSerialServer(
            nothing, port=line.device, baudrate=line.baudrate, ignore_missing_devices=True, trace_pdu=self._intercept
        )

    def _intercept(self, sending: bool, pdu: ModbusPDU) -> ModbusPDU:
        return pdu if sending else _Asked(pdu, self._ask)

    def _ask(self, request: ModbusPDU) -> Future[ModbusPDU | None]:
        response: Future[ModbusPDU | None] = Future()
        self._asked.append((request, response))
        self._wake.send(b"\0")
        return response

    # In the owner's thread

    def _deliver(self, _: int) -> None:
        self._woken.recv(4096)
        while self._asked:
            request, response = self._asked.popleft()
            if response.set_running_or_notify_cancel():
                response.set_result(self._answer(request))


class _Asked(ModbusPDU):
    """A request as pymodbus handles it: the update of its data store asks the owner."""

    def __init__(self, request: ModbusPDU, ask: Callable[[ModbusPDU], Future[ModbusPDU | None]]) -> None:
        super().__init__(dev_id=request.dev_id, transaction_id=request.transaction_id)
        self.function_code = request.function_code
        self._request = request
        self._ask = ask

    async def datastore_update(self, context: ModbusServerContext, device_id: int) -> ModbusPDU:
        """The response. Raises NoSuchIdException, after which pymodbus does not answer."""
        del context
        response = await asyncio.wrap_future(self._ask(self._request))
        if response is None:
            raise NoSuchIdException(f"unit {device_id} does not answer")
        return response


class ModbusLine:
    """Raises OSError if the line cannot be opened. `device`: the path of the serial line for the host."""

    bus = None

    def __init__(
        self,
        selector: selectors.BaseSelector,
        machine: LiveMachine,
        eds: Path,
        speed_factor: float,
        *,
        registers: RegisterLayout,
        line: TcpLine | SerialLine,
    ) -> None:
        self.cabinet = ModbusCabinet(machine, eds, registers, speed_factor)
        self._pair: PtyPair | None = None
        self.device: str | None = None
        if isinstance(line, SerialLine):
            self.device = line.device
            if line.device == "pty":
                self._pair = PtyPair(selector)
                self.device, line = self._pair.far, SerialLine(self._pair.near)
        self._server = ModbusServer(selector, line, self._answer)
        self.port = self._server.port

    def due(self, now: float) -> float:
        """Infinity: nothing is buffered."""
        del now
        return inf

    def run(self, now: float) -> None:
        """Nothing to do: nothing is buffered."""

    def close(self) -> None:
        self._server.close()
        if self._pair is not None:
            self._pair.close()

    def _answer(self, request: ModbusPDU) -> ModbusPDU | None:
        return self.cabinet.answer(request, time.monotonic())
