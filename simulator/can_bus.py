"""Any python-can interface as the bus of the drives, read by the owner's selector.

A kernel bus has a file descriptor and is read directly: each thread between a frame and its node would delay the
drive.
"""

import drivers.lean_can  # noqa: F401  # pyright: ignore[reportUnusedImport]

# isort: split
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
_RECEIVE_BUFFER = 1 << 22  # bytes, so that no SYNC is lost while the computer is busy for a second
_FORCED = 33  # SO_RCVBUFFORCE of Linux: exceeds the kernel's limit for privileged processes
_BATCH = 64  # frames processed before the timers are served
_POLL = 0.1  # s, interval at which a reading thread checks whether it must end


class CanBus:
    """`interface` and `channel` in the terms of python-can. Raises can.CanError (or OSError) if it cannot be opened."""

    def __init__(
        self, selector: selectors.BaseSelector, interface: str, channel: str, receive: Callable[[Frame], None]
    ) -> None:
        self._selector = selector
        self._receive = receive
        self._bus = cast(Any, can.Bus)(interface=interface, channel=channel)
        if isinstance(self._bus, SocketcanBus):
            _widen(self._bus.socket)
            self._inbox: SocketcanBus | Inbox = self._bus
        else:
            self._inbox = Inbox(self._bus, f"can {interface} {channel}")
        self._off = False
        self._lost = False
        selector.register(self._inbox.fileno(), selectors.EVENT_READ, self._deliver)

    def send(self, frame: Frame) -> None:
        """Send a frame; it is lost if the bus does not accept it (bus-off, queue full)."""
        if not self._off:
            self._put(can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False))

    def switch_off(self, *, off: bool) -> None:
        """Bus-off: sends an error frame, then no frame passes in either direction until it is switched on."""
        if off and not self._off:
            self._put(can.Message(arbitration_id=_BUS_OFF, data=bytes(8), is_error_frame=True))
        self._off = off

    def due(self, now: float) -> float:
        """Infinity: nothing is buffered."""
        del now
        return float("inf")

    def run(self, now: float) -> None:
        """Nothing to do: nothing is buffered."""

    def close(self) -> None:
        """Release the bus."""
        self._unregister()
        if isinstance(self._inbox, Inbox):
            self._inbox.close()
        self._bus.shutdown()

    def _put(self, message: can.Message) -> None:
        try:
            self._bus.send(message)
        except can.CanError as error:
            _log.warning("frame lost", identifier=hex(message.arbitration_id), error=str(error))

    def _deliver(self, _: int) -> None:
        for _ in range(_BATCH):
            try:
                message = self._inbox.recv(0.0)
            except can.CanError as error:
                _log.error("bus lost", error=str(error))
                self._unregister()
                return
            if message is None:
                return
            foreign = message.is_extended_id or message.is_error_frame or message.is_remote_frame
            if not (foreign or self._off):
                self._receive(Frame(message.arbitration_id, bytes(message.data)))

    def _unregister(self) -> None:
        if not self._lost:
            self._lost = True
            self._selector.unregister(self._inbox.fileno())


class Inbox:
    """Frames of a bus that a selector cannot wait for: a thread receives them, and a socket signals them."""

    def __init__(self, bus: can.BusABC, name: str) -> None:
        self._bus = bus
        self._messages: deque[can.Message] = deque()
        self._error: can.CanError | None = None
        self._wake, self._woken = socket.socketpair()
        self._woken.setblocking(False)
        self._closing = Event()
        self._thread = Thread(target=self._fetch, name=name, daemon=True)
        self._thread.start()

    def fileno(self) -> int:
        """Readable while frames wait."""
        return self._woken.fileno()

    def recv(self, _timeout: float) -> can.Message | None:
        """The next frame, None if there is none; after the last frame it raises the error that ended the bus."""
        with suppress(BlockingIOError):
            self._woken.recv(1)  # one byte per frame
        if self._messages:
            return self._messages.popleft()
        if self._error is not None:
            raise self._error
        return None

    def close(self) -> None:
        """End the thread; the bus stays open."""
        self._closing.set()
        self._thread.join()
        self._woken.close()
        self._wake.close()

    def _fetch(self) -> None:
        while not self._closing.is_set():
            try:
                message = self._bus.recv(_POLL)
            except can.CanError as error:
                self._error = error
                self._wake.send(b"\0")
                return
            if message is not None:
                self._messages.append(message)
                self._wake.send(b"\0")


def _widen(receiving: socket.socket) -> None:
    """Set the receive buffer to the largest size that the kernel allows."""
    receiving.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
    with suppress(OSError):  # needs CAP_NET_ADMIN
        receiving.setsockopt(socket.SOL_SOCKET, _FORCED, _RECEIVE_BUFFER)
