"""Any python-can interface as the drive's bus, read by the owner's selector.

A kernel's bus has a file descriptor and is read as it is: each thread between a frame and its node costs a drive time.
"""

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
_BATCH = 64  # frames taken at a time before timers have their turn
_POLL = 0.1  # s, after which a reading thread looks whether it shall end


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
            self._inbox: SocketcanBus | Inbox = self._bus
        else:
            self._inbox = Inbox(self._bus, f"can {interface} {channel}")
        self._off = False
        self._lost = False
        selector.register(self._inbox.fileno(), selectors.EVENT_READ, self._deliver)

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
    """The frames of a bus that no selector can wait for: a thread fetches them, a socket tells of them."""

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
        """The next frame, None if none waits; raises what ended the bus once its frames are out."""
        with suppress(BlockingIOError):
            self._woken.recv(1)  # a byte a frame
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
    """A receive buffer as large as the kernel grants."""
    receiving.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
    with suppress(OSError):  # needs CAP_NET_ADMIN
        receiving.setsockopt(socket.SOL_SOCKET, _FORCED, _RECEIVE_BUFFER)
