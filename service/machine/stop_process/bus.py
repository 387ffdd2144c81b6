"""The connection of the stop process to the bus, kept open by a thread, the stop over it, and its confirmation."""

import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drivers.ports import StopSender

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class StopOutcome:
    """By joint why the stop may not have arrived, or is not confirmed ("": it is); the reason if none was sent."""

    joints: Mapping[str, str] = field(default_factory=dict[str, str])
    trouble: str = ""

    @property
    def good(self) -> tuple[str, ...]:
        """The joints without an obstacle."""
        return tuple(joint for joint, doubt in self.joints.items() if not doubt)


@dataclass(frozen=True)
class _Wish:
    until: float  # s on the monotonic clock
    done: Callable[[StopOutcome], None]


class StopBus:
    """`stop` and `confirm` may be called from any thread; `stop` may wait for the drives as `StopSender.send` does."""

    take_over = 0.1  # s in which the service must take over a stop before this process insists
    merged = 0.02  # s after a stop in which another one sends no frames: a flood must not fill the bus
    again = 1.0  # s between attempts to open the bus

    def __init__(self, profile: Path, tell: Callable[[str], None]) -> None:
        """Opens the bus of the drive profile in the background; `tell` is called at each change of `trouble`."""
        self.trouble = "not connected yet"
        self._profile, self._tell = profile, tell
        self._sender: StopSender | None = None
        self._joints: tuple[str, ...] = ()
        self._open, self._wanted, self._closing = threading.Event(), threading.Event(), threading.Event()
        self._owed = False  # a stop that is sent when the bus is open again
        self._sending = threading.Lock()
        self._sent_at = float("-inf")
        self._last = StopOutcome(trouble=self.trouble)
        self._count = self._taken_over = 0
        self._wishes: queue.SimpleQueue[_Wish] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._keep, name="stop-bus", daemon=True)
        self._thread.start()
        self._following = threading.Thread(target=self._follow, name="stop-confirm", daemon=True)
        self._following.start()

    def stop(self) -> StopOutcome:
        """Send the stop for every axis; it is on the bus at return. Insists unless `taken_over` is called.

        If the bus is not open, the stop is sent as soon as it is.
        """
        with self._sending:
            if time.monotonic() - self._sent_at > self.merged:
                self._count += 1
                insisting = threading.Timer(self.take_over, self._insist_after, [self._count])
                insisting.daemon = True
                insisting.start()
                self._send()
                if self._owed:
                    self._wanted.set()
            return self._last

    def confirm(self, until: float, done: Callable[[StopOutcome], None]) -> None:
        """After `stop`: `done` is called in another thread when every axis stands without energy, or at `until`, s on
        the monotonic clock.
        """
        self._wishes.put(_Wish(until, done))

    def taken_over(self) -> None:
        """The service handles the stops sent so far."""
        self._taken_over = self._count

    def insist(self) -> None:
        """Make the drives ignore a host that may not have stopped."""
        if self._sender is not None:
            try:
                self._sender.insist()
            except Exception as error:  # noqa: BLE001 - nothing may end this process but its service
                _log.error("not insisted: %s", error)

    def close(self) -> None:
        self._closing.set()
        self._wanted.set()
        self.confirm(0.0, lambda _: None)  # wakes the thread
        self._thread.join(1.0)
        self._following.join(1.0)

    def _insist_after(self, count: int) -> None:
        if self._taken_over < count:
            self.insist()

    def _send(self) -> None:
        """Called with the lock held."""
        sender = self._sender
        try:
            if sender is not None and self._open.is_set():
                self._last = StopOutcome(sender.send())
                self._sent_at, self._owed = time.monotonic(), False
                return
        except Exception as error:  # noqa: BLE001 - an answer in any case
            self._note(str(error))
        self._open.clear()
        self._owed = True
        trouble = self.trouble or "not sent"
        self._last = StopOutcome(dict.fromkeys(self._joints, trouble), trouble)

    def _follow(self) -> None:
        pending: list[_Wish] = []
        while not self._closing.is_set():
            if not pending:
                pending.append(self._wishes.get())
            with suppress(queue.Empty):
                while True:
                    pending.append(self._wishes.get_nowait())
            outcome = self._confirmed(min(wish.until for wish in pending))
            certain = len(outcome.good) == len(outcome.joints) > 0 or not self._thread.is_alive()
            now = time.monotonic()
            over = [wish for wish in pending if certain or wish.until <= now]
            pending = [wish for wish in pending if wish not in over]
            for wish in over:
                wish.done(outcome)
            if pending:
                time.sleep(0.01)

    def _confirmed(self, until: float) -> StopOutcome:
        if self._thread.is_alive():  # otherwise only one process can open the bus
            self._open.wait(max(0.0, until - time.monotonic()))
        sender = self._sender
        if sender is None or not self._open.is_set():
            trouble = self.trouble or "not connected"
            return StopOutcome(dict.fromkeys(self._joints, trouble), trouble)
        try:
            return StopOutcome(sender.confirm(max(0.0, until - time.monotonic())))
        except Exception as error:  # noqa: BLE001 - an answer in any case
            return StopOutcome(dict.fromkeys(self._joints, str(error)))

    def _keep(self) -> None:
        # imported here, because the process listens before these are loaded
        from drivers.errors import DriveError
        from drivers.registry import open_profile

        try:
            _, port = open_profile(self._profile)
            self._joints = port.joints
            sender = port.stop_sender()
        except DriveError as error:  # also a medium with one owner: the service's own way is the only one
            self._note(str(error))
            return
        while not self._closing.is_set():
            try:
                sender.open()
                with self._sending:
                    self._sender = sender
                    self._open.set()
                    if self._owed:
                        self._send()
                    if self._open.is_set():
                        self._note("")
                while self._open.is_set() and not self._closing.is_set():  # a stop that cannot be sent closes it
                    sender.listen(0.2)
            except DriveError as error:
                self._open.clear()
                self._note(str(error))
            self._wanted.wait(self.again)
            self._wanted.clear()
        sender.close()

    def _note(self, trouble: str) -> None:
        if trouble != self.trouble:
            self.trouble = trouble
            self._tell(trouble)
