"""The epoch of intention: a stop, a gap of the host, trouble with the lease and a restart end every older command.

A command may wait: for drives that connect, a locked database, another command. What a person wanted before a stop is
not what he wants after its release. Therefore each command carries the epoch in which it was given, and the gate to
motion (`motion`) refuses one that is not of the present epoch, whatever it waited for. A release begins no epoch.
"""

import secrets
import threading
from collections import deque
from dataclasses import dataclass

from drivers.errors import Cause, CauseCode
from service.model.errors import Superseded

_REASONS = 1000  # latest ones


@dataclass(frozen=True, slots=True)
class Intention:
    """What a person wanted, or on a virtual machine a rule that a person permitted. Made where a request arrives."""

    epoch: str  # in which it was given
    by: str = ""  # the authenticated person; "" without login


class Epochs:
    """The epochs of one service, named ``<start of the service>-<count>``. Any thread."""

    def __init__(self) -> None:
        self._start = secrets.token_hex(4)  # not a time: the clock of a computer may be set back
        self._lock = threading.Lock()
        self._count = 0
        self._reasons: deque[tuple[int, Cause]] = deque(maxlen=_REASONS)  # of the beginnings, oldest first

    @property
    def now(self) -> str:
        return f"{self._start}-{self._count}"

    def begin(self, reason: Cause) -> None:
        """Every intention until now is superseded."""
        with self._lock:
            self._count += 1
            self._reasons.append((self._count, reason))

    def given(self, shown: str | None) -> str:
        """The epoch of a request that arrives now. `shown`: what the person saw, which counts if it is older.

        An epoch that has not begun yet is none: a later stop would not end the intention.
        """
        now = self.now
        return now if shown is None or shown == now else shown if self._number(shown) is not None else ""

    def since(self, intention: Intention) -> Cause | None:
        """What ended the epoch of the intention; None if nothing did."""
        if intention.epoch == self.now:
            return None
        number = self._number(intention.epoch)
        if number is None:
            return Cause(CauseCode.SERVICE_ENDED, detail="this service was started")
        with self._lock:
            return next(reason for count, reason in self._reasons if count > number)

    def check(self, intention: Intention) -> None:
        """Raises Superseded unless the intention is of the present epoch."""
        if reason := self.since(intention):
            raise Superseded(
                f"not done, because this came after the command was given: {reason}. Check the machine, then give the "
                "command again"
            )

    def _number(self, epoch: str) -> int | None:
        """The count of an earlier epoch of this service; None for any other text."""
        start, _, count = epoch.rpartition("-")
        known = start == self._start and count.isascii() and count.isdigit() and len(count) <= len(str(self._count))
        return int(count) if known and int(count) < self._count else None
