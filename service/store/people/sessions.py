"""Browser sessions of users: opened by a password, ended by time or by a person, in the audit; and their time.

The time of sessions and keys is kept in the database, so that it does not run backward over a restart.
"""

from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import structlog
from pydantic import BaseModel, ConfigDict
from sqlalchemy import delete, func, select, update

from service.model.errors import NotFound
from service.store import rows, tables as t
from service.store.access.audit_chain import Entry
from service.store.access.credentials import key_sha256, new_key
from service.store.access.permissions import Role
from service.store.database import Database
from service.store.people.audit import AuditHeads, AuditStore, append
from service.store.people.users import UserDocument


class SessionDocument(BaseModel):
    """A session without the secret of its cookie. `name` and `role` are the present ones of the user."""

    model_config = ConfigDict(frozen=True)
    id: int
    name: str
    role: Role
    address: str
    created_at: datetime
    seen_at: datetime
    expires_at: datetime
    ended_at: datetime | None
    disabled: str

    @property
    def scopes(self) -> None:
        """A user may do everything that the role allows."""

    def trouble(self, at: datetime) -> str:
        """Why it is not valid at this time; empty if it is."""
        if self.disabled or self.ended_at is not None:
            return self.disabled or f"the session of {self.name} was ended: log in again"
        return f"the session of {self.name} has expired: log in again" if at >= self.expires_at else ""


class SessionStore:
    """Every method is one transaction and blocks. `entry`: of the audit, with user and address."""

    def __init__(self, database: Database, idle: float, longest: float) -> None:
        """Times until a session ends, s: `idle` without a request, `longest` in any case."""
        self._database = database
        self._idle, self._longest = timedelta(seconds=idle), timedelta(seconds=longest)

    def open(self, user: UserDocument, entry: Entry) -> tuple[SessionDocument, str]:
        """The new session, and the secret of its cookie, which is not stored. Removes sessions that ended long ago."""
        token, address = new_key(), str(entry["address"])[:100]
        with self._database.write(quiet=True) as session:
            self._database.keep_time(session)
            at = self._database.now(session)
            session.execute(delete(t.SessionRow).where(t.SessionRow.created_at < at - self._longest))
            row = t.SessionRow(user_id=user.id, sha256=key_sha256(token), address=address, created_at=at, seen_at=at)
            session.add(row)
            session.flush()
            append(session, [{**entry, "event": "logged in", "session": row.id}])
            return self._document(row, session.get_one(t.UserRow, user.id)), token

    def now(self) -> datetime:
        """The time by which sessions expire."""
        return self._database.clock.now()

    def find(self, key: str) -> SessionDocument | None:
        """The session with this secret, including ended ones. A request resets its idle time."""
        value = key_sha256(key)
        if value is None:
            return None
        of_it = select(t.SessionRow, t.UserRow).join(t.UserRow).where(t.SessionRow.sha256 == value)
        with self._database.read() as session:
            documents = [self._document(row, user) for row, user in session.execute(of_it)]
            at = self._database.now(session)
        document = next(iter(documents), None)
        # a page sends a request per second; not every request writes
        if document is not None and not document.trouble(at) and at - document.seen_at >= timedelta(minutes=1):
            with self._database.write(quiet=True) as session:
                session.execute(update(t.SessionRow).where(t.SessionRow.id == document.id).values(seen_at=at))
                self._database.keep_time(session)
        return document

    def end(self, session_id: int, entry: Entry) -> SessionDocument:
        """Effective immediately; a second call changes nothing. Raises NotFound."""
        with self._database.write(quiet=True) as session:
            row = session.get(t.SessionRow, session_id)
            if row is None:
                raise NotFound(f"session {session_id} does not exist; `sweepid people sessions` lists all sessions")
            user = session.get_one(t.UserRow, row.user_id)
            if row.ended_at is None:
                row.ended_at = t.now()
                append(session, [{**entry, "event": "session ended", "session": row.id, "user": user.name}])
            return self._document(row, user)

    def all(self) -> tuple[SessionDocument, ...]:
        """Valid sessions, oldest first."""
        every = select(t.SessionRow, t.UserRow).join(t.UserRow).order_by(t.SessionRow.id)
        with self._database.read() as session:
            documents = [self._document(row, user) for row, user in session.execute(every)]
            at = self._database.now(session)
        return tuple(document for document in documents if not document.trouble(at))

    def _document(self, row: t.SessionRow, user: t.UserRow) -> SessionDocument:
        whose = rows.document(UserDocument, user)
        return rows.document(
            SessionDocument,
            row,
            name=whose.name,
            role=whose.role,
            expires_at=min(row.created_at + self._longest, row.seen_at + self._idle),
            disabled=whose.trouble,
        )


_log = structlog.get_logger(__name__)


def keep_time(database: Database) -> None:
    """Store the time, so that a restart does not begin before it. Blocks; at least once a minute."""
    with database.write(quiet=True, patience=1.0) as session:  # s for another writer: the next minute comes
        database.keep_time(session)


def begin_time(database: Database) -> None:
    """At the start of a service: if the clock was set back while none ran, all sessions end.

    How long that was is not known, so nobody can say how much of their time is left. Keys last longer and remain: they
    expire by the time that the database keeps.
    """
    with database.write(quiet=True) as session:
        kept = session.scalar(select(t.SteadyTimeRow.at))
        wall = database.clock.wall()
        if kept is not None and wall < kept - timedelta(seconds=60):  # by so much clocks of services may differ
            open_ones = t.SessionRow.ended_at.is_(None)
            ended = session.scalar(select(func.count()).select_from(t.SessionRow).where(open_ones)) or 0
            session.execute(update(t.SessionRow).where(open_ones).values(ended_at=wall))
            behind = round((kept - wall).total_seconds())
            append(session, [{"event": "clock set back", "actor": "service", "seconds": behind, "sessions": ended}])
            _log.error("clock_set_back", seconds=behind, ended_sessions=ended)
        database.keep_time(session)


def keeping_time_and_head(database: Database, heads_file: Path) -> Callable[[bool], None]:
    """What a service does each minute, and at its end (True): stores the time of sessions and keys, notes the head."""
    heads = AuditHeads(AuditStore(database), heads_file)

    def each_minute(ended: bool) -> None:
        keep_time(database)
        heads.note(at_end=ended)

    return each_minute
