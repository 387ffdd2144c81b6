"""Who may move the machine: one service at a time (lease), and nobody after a stop until a person resets it (latch)."""

import os
import socket
import time
import uuid
from collections.abc import Callable, Sequence
from datetime import datetime

from pydantic import JsonValue
from sqlalchemy import Select, delete, select, update
from sqlalchemy.orm import Session

from service.errors import Conflict, NotFound
from service.store import tables as t
from service.store.database import Database
from service.store.documents import EventKind, StopDocument


class MachineTaken(Conflict):
    """A second `sweepid serve` was started on the same database while the first is alive."""


class LeaseLost(Conflict):
    """This service was silent for so long that another took the machine; it must stop at once."""


class MachineLease:
    """The right to move the machine of this database.

    The holder counts `renewals` up. Who wants the lease watches that count for `lease_time` on its own monotonic
    clock: if it stands still, the holder is dead and the row is taken over by compare-and-swap. No two clocks are
    ever compared, so a stepped clock neither frees nor blocks the machine.
    """

    def __init__(self, database: Database, lease_time: float) -> None:
        """`lease_time`: s without renewal until the lease may be taken."""
        self._database = database
        self._lease_time = lease_time
        self.owner = f"{socket.gethostname()} pid {os.getpid()} {uuid.uuid4().hex[:8]}"

    def acquire(self, wait: Callable[[float], None] = time.sleep) -> None:
        """Take the lease; MachineTaken as soon as another holder shows life. Blocks for at most `lease_time`."""
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
                raise MachineTaken(f"the machine is in use by another service ({seen[0]}); stop that one first")

    def renew(self) -> None:
        """Show life; LeaseLost if another has taken the machine."""
        mine = t.LeaseRow.resource == _RESOURCE, t.LeaseRow.owner == self.owner
        with self._database.write(quiet=True) as session:
            found = session.execute(
                update(t.LeaseRow).where(*mine).values(renewals=t.LeaseRow.renewals + 1).returning(t.LeaseRow.owner)
            ).first()
        if found is None:
            raise LeaseLost("another service has taken the machine")

    def release(self) -> None:
        """Give the machine free; no effect if the lease is another's by now."""
        with self._database.write(quiet=True) as session:
            session.execute(delete(t.LeaseRow).where(t.LeaseRow.owner == self.owner))

    def _look(self) -> tuple[str, int] | None:
        with self._database.read() as session:
            row = session.get(t.LeaseRow, _RESOURCE)
            return None if row is None else (row.owner, row.renewals)

    def _try(self, dead: tuple[str, int] | None) -> tuple[str, int] | None:
        """Take a free lease, or the one whose holder is `dead`; otherwise who has it."""
        with self._database.write(quiet=True) as session:
            row = session.get(t.LeaseRow, _RESOURCE, with_for_update=True)
            if row is None:
                session.add(t.LeaseRow(resource=_RESOURCE, owner=self.owner, renewals=0))
                return None
            if (row.owner, row.renewals) == dead:
                row.owner, row.renewals = self.owner, row.renewals + 1
                return None
            return row.owner, row.renewals


_RESOURCE = "machine"  # one database serves one machine
PATIENCE = 5.0  # s


class StopLatch:
    """The stop that outlives a restart. No write waits longer than `PATIENCE` for another writer: OperationalError."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def latched(self) -> tuple[StopDocument, ...]:
        """The stops that nobody has released, oldest first."""
        with self._database.read() as session:
            return tuple(_document(row) for row in session.scalars(_open_stops()))

    def latch(self, by: str, why: str, at: datetime | None = None) -> StopDocument:
        """`at`: when it was, None: now."""
        with self._database.write(patience=PATIENCE) as session:
            row = t.StopRow(by=by, why=why, at=at or t.now())
            session.add(row)
            session.flush()
            _emit(session, [row.id], True, by, why)
            return _document(row)

    def reset(self, by: str, stops: Sequence[int]) -> tuple[StopDocument, ...]:
        """Release these stops and no other. One that is released already stays so; NotFound if one never was."""
        with self._database.write(patience=PATIENCE) as session:
            found = {row.id: row for row in session.scalars(select(t.StopRow).where(t.StopRow.id.in_(stops)))}
            for number in stops:
                if number not in found:
                    raise NotFound(f"stop {number}")
            held = [row for row in found.values() if row.reset_at is None]
            for row in held:
                row.reset_by, row.reset_at = by, t.now()
            if held:
                session.flush()
                _emit(session, [row.id for row in held], session.scalar(_open_stops()) is not None, by, "reset")
            return tuple(_document(found[number]) for number in stops)


def _open_stops() -> Select[t.StopRow]:
    return select(t.StopRow).where(t.StopRow.reset_at.is_(None)).order_by(t.StopRow.id)


def _emit(session: Session, stops: Sequence[int], latched: bool, by: str, why: str) -> None:
    """`latched`: whether any stop holds the machine now."""
    data: dict[str, JsonValue] = {"latched": latched, "by": by, "why": why, "stops": list(stops)}
    session.add(t.EventRow(campaign_id=None, kind=EventKind.STOP, data=data))


def _document(row: t.StopRow) -> StopDocument:
    return StopDocument(id=row.id, by=row.by, why=row.why, at=row.at, reset_by=row.reset_by, reset_at=row.reset_at)
