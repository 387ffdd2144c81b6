"""Any python-can interface as the drive's bus: a thread reads it, the owner's selector is woken for each batch."""

import selectors
import socket
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from threading import Event, Thread
from typing import Any, cast

import can
import structlog
from can.interfaces.socketcan import SocketcanBus

from simulator.canopen.node import Frame

_log = structlog.get_logger(__name__)
_BUS_OFF = 0x40  # SocketCAN's error class in the identifier of an error frame
_RECEIVE_BUFFER = 1 << 22  # bytes: a real drive misses no SYNC because its computer was busy for a second
_FORCED = 33  # SO_RCVBUFFORCE of Linux: beyond what the kernel allows, for who may
_POLL = 0.1  # s, after which the reader looks whether it shall end


class CanBus:
    """`interface` and `channel` as python-can names them. Raises can.CanError (or OSError) if it cannot be opened."""

    def __init__(
        self, selector: selectors.BaseSelector, interface: str, channel: str, receive: Callable[[Frame], None]
    ) -> None:
        self._selector = selector
        self._receive = receive
        self._bus = cast(Any, can.Bus)(interface=interface, channel=channel)
        if isinstance(self._bus, SocketcanBus):
            _widen(self._bus.socket)
        self._frames: deque[Frame] = deque()
        self._wake, self._woken = socket.socketpair()
        self._woken.setblocking(False)
        self._closing = Event()
        self._off = False
        selector.register(self._woken, selectors.EVENT_READ, self._deliver)
        self._reader = Thread(target=self._read, name=f"can {interface} {channel}", daemon=True)
        self._reader.start()

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus; a bus that does not take it (bus-off, queue full) loses it."""
        if not self._off:
            self._put(can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False))

    def switch_off(self, *, off: bool) -> None:
        """Bus-off: an error frame says so, then no frame passes either way until it is on again."""
        if off and not self._off:
            self._put(can.Message(arbitration_id=_BUS_OFF, data=bytes(8), is_error_frame=True))
        self._off = off

    def due(self, now: float) -> float:
        """Nothing is ever kept back."""
        del now
        return float("inf")

    def run(self, now: float) -> None:
        """Nothing is ever kept back."""

    def close(self) -> None:
        """End the reader and release the bus."""
        self._closing.set()
        self._reader.join()
        self._selector.unregister(self._woken)
        self._woken.close()
        self._wake.close()
        self._bus.shutdown()

    def _put(self, message: can.Message) -> None:
        try:
            self._bus.send(message)
        except can.CanError as error:
            _log.warning("frame lost", identifier=hex(message.arbitration_id), error=str(error))

    def _read(self) -> None:
        while not self._closing.is_set():
            try:
                message = self._bus.recv(_POLL)
            except can.CanError as error:
                _log.error("bus lost", error=str(error))
                return
            if message is None or message.is_extended_id or message.is_error_frame or message.is_remote_frame:
                continue
            self._frames.append(Frame(message.arbitration_id, bytes(message.data)))
            self._wake.send(b"\0")

    def _deliver(self, _: int) -> None:
        self._woken.recv(4096)
        while self._frames:
            frame = self._frames.popleft()
            if not self._off:
                self._receive(frame)


def _widen(receiving: socket.socket) -> None:
    """A receive buffer as large as the kernel grants."""
    receiving.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
    with suppress(OSError):  # needs CAP_NET_ADMIN
        receiving.setsockopt(socket.SOL_SOCKET, _FORCED, _RECEIVE_BUFFER)
