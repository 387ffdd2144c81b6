"""A node's way to the bus and to time, as durand wants them: one thread, no clock of its own."""

import errno
import heapq
import itertools
import selectors
import socket
import struct
import threading
from collections.abc import Callable
from typing import Any

from durand.network import NetworkABC
from durand.scheduler import AbstractScheduler

from simulator.canopen.pdo import Frame

Take = Callable[[int, bytes], None]
_TPDOS = (0x180, 0x280, 0x380, 0x480)
_CAN_FRAME = struct.Struct("=IB3x8s")  # of the kernel
_NO_DATA_FRAME = 0xE0000000  # extended, remote or error frame
_LOST = (errno.EAGAIN, errno.ENOBUFS, errno.ENETDOWN)


class Network(NetworkABC):
    """One node's subscriptions, with the troubles that may be ordered: `mute`, and TPDOs to lose."""

    def __init__(self, put: Take) -> None:
        self._put = put
        self._subscriptions: dict[int, Take] = {}
        self.mute = False
        self.lose_tpdos = 0

    def add_subscription(self, cob_id: int, callback: Take) -> None:
        self._subscriptions[cob_id] = callback

    def remove_subscription(self, cob_id: int) -> None:
        self._subscriptions.pop(cob_id, None)

    def send(self, cob_id: int, msg: bytes) -> None:
        if self.lose_tpdos and cob_id & ~0x7F in _TPDOS:
            self.lose_tpdos -= 1
        elif not self.mute:
            self._put(cob_id, bytes(msg))

    def receive(self, cob_id: int, msg: bytes) -> None:
        """A frame of the bus."""
        callback = self._subscriptions.get(cob_id)
        if callback is not None:
            callback(cob_id, msg)


class KernelBus:
    """Frames of the kernel's bus on the open SocketCAN socket `number`; what it does not take is lost."""

    port = None

    def __init__(self, selector: selectors.BaseSelector, number: int, receive: Callable[[Frame], None]) -> None:
        self._socket = socket.socket(fileno=number)
        self._socket.setblocking(False)
        self._receive = receive
        selector.register(self._socket, selectors.EVENT_READ, self._read)

    def send(self, frame: Frame) -> None:
        try:
            self._socket.send(_CAN_FRAME.pack(frame.id, len(frame.data), frame.data))
        except OSError as error:
            if error.errno not in _LOST:
                raise

    def _read(self, _: int) -> None:
        try:
            identifier, length, data = _CAN_FRAME.unpack(self._socket.recv(_CAN_FRAME.size))
        except OSError as error:
            if error.errno not in _LOST:
                raise
            return
        if not identifier & _NO_DATA_FRAME:
            self._receive(Frame(identifier, data[:length]))

    def due(self, _: float) -> float:
        """As of `SocketcandServer`: nothing is held back here."""
        return float("inf")

    def run(self, _: float) -> None:
        """Nothing is held back here."""


class Timers(AbstractScheduler[Any]):
    """Callbacks that fall due by the clock that `run` is given, s."""

    def __init__(self, now: float) -> None:
        self._now = now
        self._entries: list[tuple[float, int, Callable[[], None]]] = []
        self._cancelled: set[int] = set()
        self._numbers = itertools.count()
        self._lock = threading.Lock()

    def add(self, delay: float, callback: Any, args: tuple[Any, ...] = (), kwargs: Any = None) -> int:
        number = next(self._numbers)
        heapq.heappush(self._entries, (self._now + delay, number, lambda: callback(*args, **(kwargs or {}))))
        return number

    def cancel(self, entry: int) -> None:
        self._cancelled.add(entry)

    @property
    def lock(self) -> threading.Lock:
        return self._lock

    def run(self, now: float) -> None:
        """What is due by now."""
        self._now = now
        while self._entries and self._entries[0][0] <= now:
            _, number, callback = heapq.heappop(self._entries)
            if number in self._cancelled:
                self._cancelled.discard(number)
            else:
                callback()

    def due(self, now: float) -> float:
        """Seconds until `run` is wanted."""
        return max(0.0, self._entries[0][0] - now) if self._entries else 1.0
