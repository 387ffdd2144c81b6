"""The audit: caller, request, address and outcome."""

import json
from collections.abc import Iterable, Iterator, Sequence
from typing import cast

from pydantic import BaseModel, ConfigDict, JsonValue
from sqlalchemy import func, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from service.model.errors import SweepidError
from service.store import rows
from service.store import tables as t
from service.store.access.audit_chain import FIRST, Entry, Head, Link, canonical, sha256
from service.store.database import Transactions

_PIECE = 1000  # entries read per query


class AuditUnreadable(SweepidError):
    """The table is damaged or missing, or the database does not answer (API: 503)."""


class AuditDocument(BaseModel):
    """One entry. `sha256` is computed over that of the previous entry and the canonical JSON of this one's `entry`."""

    model_config = ConfigDict(frozen=True)
    number: int
    entry: dict[str, JsonValue]
    sha256: str


class AuditStore(Transactions):
    """Every method is one transaction and blocks. Reading methods raise AuditUnreadable."""

    def append(self, entries: Sequence[Entry]) -> int:
        """Add entries in this order. Returns the number of the first."""
        with self._database.write(quiet=True) as session:
            return append(session, entries)

    def documents(self, after: int = 0, limit: int = 100) -> tuple[AuditDocument, ...]:
        return tuple(
            AuditDocument(number=number, entry=_content(number, entry), sha256=value)
            for number, entry, value in self._piece(after, limit)
        )

    def newest(self, limit: int) -> tuple[AuditDocument, ...]:
        """The last entries, in their order."""
        try:
            with self._database.read() as session:
                last = session.scalar(select(func.max(t.AuditRow.number))) or 0
        except SQLAlchemyError as error:
            raise _unreadable(error) from error
        return self.documents(max(0, last - limit), limit)

    def head(self) -> Head:
        """Number and hash of the last entry; (0, FIRST) if there is none."""
        try:
            with self._database.read() as session:
                last = session.scalar(select(t.AuditRow).order_by(t.AuditRow.number.desc()).limit(1))
                return (0, FIRST) if last is None else (last.number, last.sha256)
        except SQLAlchemyError as error:
            raise _unreadable(error) from error

    def links(self) -> Iterator[Link]:
        """The whole chain, in batches."""
        after = 0
        while piece := self._piece(after, _PIECE):
            yield from piece
            after = piece[-1][0]

    def _piece(self, after: int, limit: int) -> tuple[Link, ...]:
        query = select(t.AuditRow).where(t.AuditRow.number > after).order_by(t.AuditRow.number).limit(limit)
        try:
            with self._database.read() as session:
                return tuple((row.number, row.entry, row.sha256) for row in session.scalars(query))
        except SQLAlchemyError as error:
            raise _unreadable(error) from error


def _unreadable(error: SQLAlchemyError) -> AuditUnreadable:
    reason = " ".join(str(getattr(error, "orig", None) or type(error).__name__).split())
    return AuditUnreadable(
        f"the audit cannot be read: {reason}; check it with `sweepid data doctor`, restore a backup if it is damaged"
    )


def _content(number: int, entry: str) -> dict[str, JsonValue]:
    """Content of what should be the canonical JSON of an entry."""
    try:
        found: object = json.loads(entry)
    except ValueError:
        found = None
    if not isinstance(found, dict):
        raise AuditUnreadable(
            f"audit entry {number} is not a JSON object: it was changed; `sweepid audit verify` shows where"
        )
    return cast("dict[str, JsonValue]", found)


def append(session: Session, entries: Iterable[Entry]) -> int:
    """Add entries within the caller's transaction. Returns the number of the first. Each names the service's machine,
    if any.
    """
    owned = rows.owned(session)
    where: Entry = {} if owned is None else {"machine": owned.name}
    last = session.scalar(select(t.AuditRow).order_by(t.AuditRow.number.desc()).limit(1))
    number, previous = (0, FIRST) if last is None else (last.number, last.sha256)
    first = number + 1
    for entry in entries:
        number += 1
        text = canonical({**where, **entry, "number": number, "at": t.now().isoformat()})
        previous = sha256(previous, text)
        session.add(t.AuditRow(number=number, entry=text, sha256=previous))
    return first
