"""Browser sessions of users: opened by a password, ended by time or by a person. They are in the audit."""

from datetime import datetime, timedelta

from pydantic import BaseModel, ConfigDict
from sqlalchemy import delete, select, update

from service.model.errors import NotFound
from service.store import rows
from service.store import tables as t
from service.store.access.audit_chain import Entry
from service.store.access.keys import key_sha256, new_key
from service.store.access.permissions import Role
from service.store.database import Database
from service.store.people.audit import append
from service.store.people.time import keep
from service.store.people.users import UserDocument

_SEEN_EVERY = timedelta(minutes=1)  # a page sends a request per second; not every request writes


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
            keep(session, self._database)
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
        if document is not None and not document.trouble(at) and at - document.seen_at >= _SEEN_EVERY:
            with self._database.write(quiet=True) as session:
                session.execute(update(t.SessionRow).where(t.SessionRow.id == document.id).values(seen_at=at))
                keep(session, self._database)
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
