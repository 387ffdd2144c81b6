"""What a start needs: an intention of the present epoch; where required an approval, and then signs of life.

The epoch of intention: a stop, a gap of the host, trouble with the lease and a restart end every older command. A
command may wait: for drives that connect, a locked database, another command. What a person wanted before a stop is not
what he wants after its release. Therefore each command carries the epoch in which it was given, and the gate to motion
(`motion`) refuses one that is not of the present epoch, whatever it waited for. A release begins no epoch.
"""

import asyncio
import secrets
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import timedelta

from drivers.errors import Cause, CauseCode
from service import BadInput, Conflict, Superseded
from service.store.lease_and_latch import ApprovalDocument, ApprovalStore
from service.store.tables import now


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
        self._reasons: deque[tuple[int, Cause]] = deque(maxlen=1000)  # of the beginnings, oldest first

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


class Approvals:
    """Blocking, because it reads the store. `by`: the authenticated person who starts; "" without login."""

    def __init__(self, store: ApprovalStore, needed: bool, valid: timedelta) -> None:
        """`valid`: how long an approval is valid."""
        self._store, self.needed, self._valid = store, needed, valid

    def add(
        self, plan_id: int, shown: str, sha256: str, approved_by: str, wanted: Callable[[], None]
    ) -> ApprovalDocument:
        """`shown`: the hash of the content displayed to the person. Raises Conflict if it is not the present one.

        `wanted` raises Superseded; it is called in the transaction, for which the approval may have waited.
        """
        if not approved_by:
            raise BadInput("approved_by", "login is disabled: give the name of the person who approves")
        if shown != sha256:
            raise Conflict(f"plan {plan_id} changed after it was displayed: review it again ({sha256})")
        return self._store.add(plan_id, sha256, approved_by, self._valid, wanted)

    def of_plan(self, plan_id: int) -> tuple[ApprovalDocument, ...]:
        return self._store.of_plan(plan_id)

    def missing(self, plan_id: int, sha256: str, by: str = "") -> str:
        """Why a motion of the plan with this hash may not be started; empty if it may."""
        if not self.needed:
            return ""
        found = self._store.of_plan(plan_id)
        at = now()
        good = [approval for approval in found if not approval.trouble(sha256, at)]
        if good and (not by or any(approval.approved_by != by for approval in good)):
            return ""
        if good:
            return f"plan {plan_id} is approved by {by} alone: another person must approve it, or start it"
        reason = found[0].trouble(sha256, at) if found else "not approved yet"
        return f"plan {plan_id} requires the approval of an engineer: {reason}"

    def check(self, plan_id: int | None, sha256: str, by: str) -> None:
        """Raises Conflict unless the motion may be started."""
        reason = "" if plan_id is None else self.missing(plan_id, sha256, by)
        if reason:
            raise Conflict(reason)


class SignOfLife:
    """For one run of a campaign, on the event loop. `missed` is called once, with the cause, unless `end` is called
    before.
    """

    def __init__(self, within: float, missed: Callable[[Cause], None]) -> None:
        """`within`: maximum time between two signs of life, s; the first one is the start."""
        self.within = within
        self._missed = missed
        self._loop = asyncio.get_running_loop()
        self._timer = self._set()

    @property
    def left(self) -> float:
        """s until a sign of life is missed."""
        return max(0.0, self._timer.when() - self._loop.time())

    def renew(self) -> None:
        self._timer.cancel()
        self._timer = self._set()

    def end(self) -> None:
        self._timer.cancel()

    def _set(self) -> asyncio.TimerHandle:
        why = (
            f"no sign of life within {self.within:g} s, which the start of this run requires: no "
            "person monitors the machine"
        )
        cause = Cause(CauseCode.SIGN_OF_LIFE, limit=self.within, unit="s", detail=why)
        return self._loop.call_later(self.within, self._missed, cause)
