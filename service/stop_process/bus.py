"""The connection of the stop process to the bus, kept open by a thread, and the stop over it."""

import logging
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drivers.ports import StopSender

_log = logging.getLogger(__name__)

TAKE_OVER = 0.1  # s in which the service must take over a stop before this process insists
_AGAIN = 1.0  # s between attempts to open the bus
_OPENING = 1.0  # s that a stop waits for the bus to be reopened


@dataclass(frozen=True)
class Outcome:
    """The joints whose drives got the stop, with a possible obstacle ("": none); or the reason if none got it."""

    joints: Mapping[str, str] = field(default_factory=dict[str, str])
    trouble: str = ""

    @property
    def told(self) -> tuple[str, ...]:
        """The joints whose drives receive the stop."""
        return tuple(joint for joint, doubt in self.joints.items() if not doubt)


class Bus:
    """`stop` may be called from any thread."""

    def __init__(self, profile: Path, tell: Callable[[str], None]) -> None:
        """Opens the bus of the drive profile in the background; `tell` is called at each change of `trouble`."""
        self.trouble = "not connected yet"
        self._profile, self._tell = profile, tell
        self._sender: StopSender | None = None
        self._open, self._wanted, self._closing = threading.Event(), threading.Event(), threading.Event()
        self._sending = threading.Lock()
        self._count = self._taken_over = 0
        self._thread = threading.Thread(target=self._keep, name="stop-bus", daemon=True)
        self._thread.start()

    def stop(self) -> Outcome:
        """Send the stop for every axis; it is on the bus at return. Insists unless `taken_over` is called."""
        with self._sending:
            self._count += 1
            insisting = threading.Timer(TAKE_OVER, self._insist_after, [self._count])
            insisting.daemon = True
            insisting.start()
            return self._send()

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
        self._thread.join(1.0)

    def _insist_after(self, count: int) -> None:
        if self._taken_over < count:
            self.insist()

    def _send(self) -> Outcome:
        for attempt in range(2):
            sender = self._sender
            try:
                if sender is not None:
                    return Outcome(sender.send())
            except Exception as error:  # noqa: BLE001 - an answer in any case
                self._note(str(error))
            if attempt == 0:
                if not self._thread.is_alive():  # a bus that only one process can open
                    break
                self._open.clear()
                self._wanted.set()
                self._open.wait(_OPENING)
        return Outcome(trouble=self.trouble or "not sent")

    def _keep(self) -> None:
        # imported here, because the process listens before these are loaded
        from drivers.errors import DriveError
        from drivers.registry import open_profile

        try:
            _, port = open_profile(self._profile)
            sender = port.stop_sender()
        except DriveError as error:  # also a medium with one owner: the service's own way is the only one
            self._note(str(error))
            self._open.set()
            return
        while not self._closing.is_set():
            try:
                sender.open()
                self._sender = sender
                self._note("")
                self._open.set()
                while not self._closing.is_set():
                    sender.listen(0.2)
            except DriveError as error:
                self._note(str(error))
            self._wanted.wait(_AGAIN)
            self._wanted.clear()
        sender.close()

    def _note(self, trouble: str) -> None:
        if trouble != self.trouble:
            self.trouble = trouble
            self._tell(trouble)
