"""What must hold before a machine moves or a request is executed.

One service at a time may move a machine (lease), none after a stop until a person resets it (latch), a plan only with
an approval where it is needed; a request that is sent twice has one effect (idempotency key).
"""

import os
import socket
import time
import uuid
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta

from pydantic import JsonValue
from sqlalchemy import Select, delete, func, select, update
from sqlalchemy.orm import Session

from drivers.errors import Cause
from service import Conflict, NotFound
from service.store import table_rows as rows, tables as t
from service.store.database import Database
from service.store.documents import EventKind, StopDocument, StoredAnswer, StoredDocument


class MachineTaken(Conflict):
    """A second `sweepid serve` was started on the same database while the first is running."""


class LeaseLost(Conflict):
    """This service did not renew the lease in time and another took the machine; it must stop at once."""


class MachineLease:
    """The right to move one machine of this database, the one of the service whose `database` it is.

    The holder increments `renewals`. A service that wants the lease watches this count for `lease_time` on its own
    monotonic clock: if it does not change, the holder is dead and the row is taken by compare-and-swap. No two
    clocks are compared, so a clock that is set neither frees nor blocks the machine.
    """

    def __init__(self, database: Database, lease_time: float, machine: t.OwnMachine | None = None) -> None:
        """`lease_time`: s without renewal until the lease may be taken. `machine`: None uses that of the database.

        Raises NoMachine if there is none.
        """
        machine = machine or database.machine
        if machine is None:
            raise rows.NoMachine
        self._database, self._machine = database, machine
        self._resource = f"machine {machine.id}"
        self._lease_time = lease_time
        self.owner = f"{socket.gethostname()} pid {os.getpid()} {uuid.uuid4().hex[:8]}"

    def acquire(self, wait: Callable[[float], None] = time.sleep) -> None:
        """Take the lease. Raises MachineTaken as soon as another holder renews it. Blocks for at most `lease_time`."""
        seen = self._try(None)
        deadline = time.monotonic() + self._lease_time
        while seen is not None:
            if time.monotonic() >= deadline:
                before, seen = seen, self._try(seen)
            else:
                wait(self._lease_time / 20)
                before, seen = seen, self._look()
                if seen is None:
                    seen = self._try(None)
            if seen is not None and seen != before:
                raise MachineTaken(
                    f"the machine is in use by another service ({seen[0]}): stop that service, or, if "
                    f"this service has another machine than {self._machine.name!r}, set `machine_name` "
                    "to its name"
                )

    def renew(self) -> None:
        """Renew the lease. Raises LeaseLost if another service has taken the machine."""
        mine = t.LeaseRow.resource == self._resource, t.LeaseRow.owner == self.owner
        with self._database.write(quiet=True) as session:
            found = session.execute(
                update(t.LeaseRow).where(*mine).values(renewals=t.LeaseRow.renewals + 1).returning(t.LeaseRow.owner)
            ).first()
        if found is None:
            raise LeaseLost("another service has taken the machine")

    def release(self) -> None:
        """Release the machine; no effect if another service has the lease."""
        with self._database.write(quiet=True) as session:
            session.execute(delete(t.LeaseRow).where(t.LeaseRow.owner == self.owner))

    def _look(self) -> tuple[str, int] | None:
        with self._database.read() as session:
            row = session.get(t.LeaseRow, self._resource)
            return None if row is None else (row.owner, row.renewals)

    def _try(self, dead: tuple[str, int] | None) -> tuple[str, int] | None:
        """Take a free lease, or the one whose holder is `dead`; otherwise return the holder."""
        with self._database.write(quiet=True) as session:
            row = session.get(t.LeaseRow, self._resource)
            if row is None:
                session.add(t.LeaseRow(resource=self._resource, owner=self.owner, renewals=0))
                return None
            if (row.owner, row.renewals) == dead:
                row.owner, row.renewals = self.owner, row.renewals + 1
                return None
            return row.owner, row.renewals


PATIENCE = 5.0  # s


class StopLatch(rows.Transactions):
    """The stop of a machine, kept over a restart.

    No write waits longer than `PATIENCE` for another writer: then OperationalError.
    """

    def latched(self) -> tuple[StopDocument, ...]:
        """The stops that are not released, oldest first."""
        with self._database.read() as session:
            return rows.documents(StopDocument, session, _open_stops(session))

    def latch(self, by: str, why: str, at: datetime | None = None, cause: Cause | None = None) -> StopDocument:
        """`at`: time of the stop, None: now."""
        with self._database.write(patience=PATIENCE) as session:
            row = t.StopRow(
                machine_id=rows.own_id(session), by=by, why=why, at=at or t.now(), cause=rows.cause_json(cause)
            )
            rows.added(session, row)
            _emit(session, [row.id], True, by, why)
            return rows.document(StopDocument, row)

    def repeat(self, stop: int) -> None:
        """It was pressed again: approvals that were given since it was stored end as well."""
        with self._database.write(patience=PATIENCE) as session:
            mine = t.ApprovalRow.machine_id == rows.own_id(session)
            given_since = update(t.ApprovalRow).where(mine, t.ApprovalRow.last_stop >= stop)
            session.execute(given_since.values(last_stop=stop - 1))

    def reset(self, by: str, stops: Sequence[int]) -> tuple[StopDocument, ...]:
        """Release these stops and no other. A released one stays so. Raises NotFound if one does not exist."""
        with self._database.write(patience=PATIENCE) as session:
            mine = t.StopRow.machine_id == rows.own_id(session)
            found = {row.id: row for row in session.scalars(select(t.StopRow).where(t.StopRow.id.in_(stops), mine))}
            for number in stops:
                if number not in found:
                    raise NotFound(f"stop {number}")
            held = [row for row in found.values() if row.reset_at is None]
            for row in held:
                row.reset_by, row.reset_at = by, t.now()
            if held:
                session.flush()
                _emit(session, [row.id for row in held], session.scalar(_open_stops(session)) is not None, by, "reset")
            return tuple(rows.document(StopDocument, found[number]) for number in stops)


def _open_stops(session: Session) -> Select[t.StopRow]:
    mine = t.StopRow.machine_id == rows.own_id(session)
    return select(t.StopRow).where(t.StopRow.reset_at.is_(None), mine).order_by(t.StopRow.id)


def _emit(session: Session, stops: Sequence[int], latched: bool, by: str, why: str) -> None:
    """`latched`: whether any stop holds the machine now."""
    data: dict[str, JsonValue] = {"latched": latched, "by": by, "why": why, "stops": list(stops)}
    rows.emit(session, None, EventKind.STOP, data)


class ApprovalDocument(StoredDocument):
    """One approval; `sha256` is the hash of the approved motion. `ended_by`: id of a later stop of its machine."""

    id: int
    plan_id: int
    sha256: str
    approved_by: str
    at: datetime
    expires_at: datetime
    ended_by: int | None

    def trouble(self, sha256: str, at: datetime) -> str:
        """Why it is not valid for this motion at this time; empty if it is."""
        who = f"the approval by {self.approved_by} of {self.at:%Y-%m-%d %H:%M} UTC"
        if self.sha256 != sha256:
            return f"{who} is no longer valid: robot, cell, drives, settings or program have changed since"
        if self.ended_by is not None:
            return f"{who} was ended by stop {self.ended_by} of the machine, which came after it: approve it again"
        if not self.at <= at:
            return f"{who} is in the future: the clock of the computer was set back"
        return f"{who} expired at {self.expires_at:%Y-%m-%d %H:%M} UTC" if at >= self.expires_at else ""


class ApprovalStore(rows.Transactions):
    """Every method is one transaction and blocks, as in `service.store.store`."""

    def add(
        self, plan_id: int, sha256: str, approved_by: str, valid: timedelta, wanted: Callable[[], None]
    ) -> ApprovalDocument:
        """Raises NotFound if the plan does not exist, and what `wanted` raises."""
        with self._database.write(quiet=True) as session:
            machine = rows.own_id(session)
            last_stop = _last_stop(session, machine)  # read before `wanted`: a stop between the two ends the approval
            wanted()
            rows.get(session, t.PlanRow, plan_id, "plan")
            at = t.now()
            row = t.ApprovalRow(
                machine_id=machine,
                plan_id=plan_id,
                sha256=sha256,
                approved_by=approved_by,
                at=at,
                expires_at=at + valid,
                last_stop=last_stop,
            )
            return _document(rows.added(session, row), last_stop)

    def of_plan(self, plan_id: int) -> tuple[ApprovalDocument, ...]:
        """Approvals for this service's machine, the newest first, at most a hundred."""
        query = select(t.ApprovalRow).where(t.ApprovalRow.plan_id == plan_id).order_by(t.ApprovalRow.id.desc())
        with self._database.read() as session:
            machine = rows.owned(session)
            if machine is not None:
                query = query.where(t.ApprovalRow.machine_id == machine.id)
            return tuple(
                _document(row, _last_stop(session, row.machine_id)) for row in session.scalars(query.limit(100)).all()
            )


def _last_stop(session: Session, machine: int) -> int:
    """The id of the newest stop of a machine, 0: none. Ids have an order also when the clock was set."""
    return session.scalar(select(func.max(t.StopRow.id)).where(t.StopRow.machine_id == machine)) or 0


def _document(row: t.ApprovalRow, last_stop: int) -> ApprovalDocument:
    return rows.document(ApprovalDocument, row, ended_by=last_stop if last_stop > row.last_stop else None)


class KeyReused(Conflict):
    """The key was used before with another request: an error of the client program (API: 422)."""


class IdempotencyKeys(rows.Transactions):
    """Claim a key, do the work, store the answer; release the key if the work failed."""

    def claim(self, key: str, fingerprint: str) -> StoredAnswer | None:
        """None: continue, the key is claimed. `fingerprint`: hash of method, path and body, at most 64 characters.

        Raises Conflict while the first request with this key is in progress; KeyReused if it was another request.
        """
        with self._database.write(quiet=True) as session:
            machine = rows.own_id(session)
            row = session.get(t.IdempotencyRow, (machine, key))
            if row is None:
                session.add(t.IdempotencyRow(machine_id=machine, key=key, fingerprint=fingerprint))
                return None
            if row.fingerprint != fingerprint:
                raise KeyReused(f"Idempotency-Key {key!r} was used for another request")
            if row.status is None:
                raise Conflict(f"the request with Idempotency-Key {key!r} is still being processed")
            return StoredAnswer(status=row.status, body=row.body)

    def answer(self, key: str, status: int, body: str) -> None:
        """Store the answer for repeated requests with this key."""
        with self._database.write(quiet=True) as session:
            row = session.get_one(t.IdempotencyRow, (rows.own_id(session), key))
            row.status, row.body = status, body

    def release(self, key: str) -> None:
        """The work failed without effect: the key may be used again."""
        with self._database.write(quiet=True) as session:
            mine = t.IdempotencyRow.machine_id == rows.own_id(session)
            session.execute(delete(t.IdempotencyRow).where(t.IdempotencyRow.key == key, mine))

    def release_unanswered(self) -> None:
        """At start: requests that the last process did not finish may be sent again."""
        with self._database.write(quiet=True) as session:
            mine = t.IdempotencyRow.machine_id == rows.own_id(session)
            session.execute(delete(t.IdempotencyRow).where(t.IdempotencyRow.status.is_(None), mine))
