"""Which service may move a machine: one at a time (lease), and none after a stop until a person resets it (latch)."""

import os
import socket
import time
import uuid
from collections.abc import Callable, Sequence
from datetime import datetime

from pydantic import JsonValue
from sqlalchemy import Select, delete, select, update
from sqlalchemy.orm import Session

from drivers.errors import Cause
from service.model.errors import Conflict, NotFound
from service.store import rows
from service.store import tables as t
from service.store.database import Database, OwnMachine, Transactions
from service.store.documents import EventKind, StopDocument


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

    def __init__(self, database: Database, lease_time: float, machine: OwnMachine | None = None) -> None:
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


class StopLatch(Transactions):
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
                machine_id=rows.own(session), by=by, why=why, at=at or t.now(), cause=rows.cause_json(cause)
            )
            session.add(row)
            session.flush()
            _emit(session, [row.id], True, by, why)
            return rows.document(StopDocument, row)

    def reset(self, by: str, stops: Sequence[int]) -> tuple[StopDocument, ...]:
        """Release these stops and no other. A released one stays so. Raises NotFound if one does not exist."""
        with self._database.write(patience=PATIENCE) as session:
            mine = t.StopRow.machine_id == rows.own(session)
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
    mine = t.StopRow.machine_id == rows.own(session)
    return select(t.StopRow).where(t.StopRow.reset_at.is_(None), mine).order_by(t.StopRow.id)


def _emit(session: Session, stops: Sequence[int], latched: bool, by: str, why: str) -> None:
    """`latched`: whether any stop holds the machine now."""
    data: dict[str, JsonValue] = {"latched": latched, "by": by, "why": why, "stops": list(stops)}
    rows.emit(session, None, EventKind.STOP, data)
