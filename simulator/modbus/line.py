"""The cabinet on its Modbus line: TCP, a serial device, or a pseudo-terminal created here."""

import asyncio
import contextlib
import os
import selectors
import socket
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from math import inf
from pathlib import Path
from threading import Thread
from typing import Any, cast

from pymodbus.datastore import ModbusServerContext
from pymodbus.exceptions import NoSuchIdException
from pymodbus.pdu import ModbusPDU
from pymodbus.server import ModbusBaseServer, ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from simulator.machine import LiveMachine
from simulator.modbus.cabinet import ModbusCabinet
from simulator.modbus.registers import RegisterLayout


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
        """Remove both terminals."""
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
            nothing,
            port=line.device,
            baudrate=line.baudrate,
            ignore_missing_devices=True,
            trace_pdu=self._intercept,
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
        """Release the line."""
        self._server.close()
        if self._pair is not None:
            self._pair.close()

    def _answer(self, request: ModbusPDU) -> ModbusPDU | None:
        return self.cabinet.answer(request, time.monotonic())
