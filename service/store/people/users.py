"""Users with passwords or of an identity provider, and API keys. Each change is in the audit, in its transaction.

Passwords: argon2id with the parameters that its library recommends. A hash takes about 0.1 s and 64 MiB: never compute
it on the event loop, and never many at the same time.

Browser sessions of users: opened by a password, ended by time or by a person, in the audit; and their time.

The time of sessions and keys is kept in the database, so that it does not run backward over a restart.
"""

import base64
import unicodedata
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from pathlib import Path

import structlog
from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError
from pydantic import BaseModel, ConfigDict
from sqlalchemy import delete, func, select, update
from sqlalchemy.orm import Session

from service import BadInput, Conflict, NotFound
from service.store import table_rows as rows, tables as t
from service.store.access import Role, key_sha256, new_key, unique_name
from service.store.database import Database
from service.store.people.audit import AuditHeads, AuditStore, Entry, Fact, append


class UserDocument(BaseModel):
    """A user without the password. `issuer`, `subject`: for users of an identity provider, else None."""

    model_config = ConfigDict(frozen=True)
    id: int
    name: str
    role: Role
    created_at: datetime
    disabled_at: datetime | None
    issuer: str | None = None
    subject: str | None = None

    @property
    def trouble(self) -> str:
        """Why a login as this user is refused; empty if it is allowed."""
        return "" if self.disabled_at is None else f"{self.name} was disabled on {self.disabled_at:%Y-%m-%d}"


class UserStore(rows.Transactions):
    """Every method is one transaction and blocks; those with a password take about 0.1 s.

    `entry`: of the audit, with user and address.
    """

    def add(self, name: str, role: Role, password: str, entry: Entry) -> UserDocument:
        """Raises BadInput for a password that is too short; Conflict if the name was used before."""
        stored = password_hash(password)
        with self._database.write(quiet=True) as session:
            check_free(session, name)
            row = rows.added(session, t.UserRow(name=name, role=role, password=stored))
            append(session, [{**entry, "event": "user added", "user": name, "user_role": role.word}])
            return rows.document(UserDocument, row)

    def change_password(self, name: str, password: str, entry: Entry) -> UserDocument:
        """Ends the sessions with the old password. Raises BadInput; NotFound; Conflict if disabled or external."""
        stored = password_hash(password)
        with self._database.write(quiet=True) as session:
            row = _row(session, name)
            if row.disabled_at is not None:
                why = rows.document(UserDocument, row).trouble
                raise Conflict(f"{why}: enable the user again with `sweepid people enable-user`")
            if row.issuer is not None:
                raise Conflict(f"{name} logs in at {row.issuer} and has no password in this service")
            row.password = stored
            end_sessions(session, row)
            append(session, [{**entry, "event": "password changed", "user": name}])
            return rows.document(UserDocument, row)

    def set_enabled(self, name: str, entry: Entry, enabled: bool = True) -> UserDocument:
        """Enable a user, or disable at once and end all sessions for ever; a second call changes nothing. NotFound."""
        with self._database.write(quiet=True) as session:
            row = _row(session, name)
            if (row.disabled_at is None) is not enabled:
                row.disabled_at = None if enabled else t.now()
                if not enabled:
                    end_sessions(session, row)
                append(session, [{**entry, "event": f"user {'enabled' if enabled else 'disabled'}", "user": name}])
            return rows.document(UserDocument, row)

    def all(self) -> tuple[UserDocument, ...]:
        return self._all(UserDocument, select(t.UserRow).order_by(t.UserRow.id))

    def knows(self, name: str) -> bool:
        with self._database.read() as session:
            return session.scalar(select(t.UserRow.id).where(t.UserRow.name == name)) is not None

    def check(self, name: str, password: str) -> UserDocument | None:
        """The user; None for a wrong password, an unknown name or a disabled user, all of which take the same time.

        A hash with parameters that differ from the library's present ones is replaced.
        """
        with self._database.read() as session:
            row = session.scalar(select(t.UserRow).where(t.UserRow.name == name))
            stored, user = (None, None) if row is None else (row.password, rows.document(UserDocument, row))
        if not fits(password, stored) or user is None or stored is None or user.trouble:
            return None
        if outdated(stored):
            unchanged = t.UserRow.id == user.id, t.UserRow.password == stored  # unless it was changed meanwhile
            replaced = update(t.UserRow).where(*unchanged).values(password=password_hash(password))
            with self._database.write(quiet=True) as session:
                session.execute(replaced)
        return user


def _row(session: Session, name: str) -> t.UserRow:
    row = session.scalar(select(t.UserRow).where(t.UserRow.name == name))
    if row is None:
        raise NotFound(f"user {name} does not exist; `sweepid people list` lists all users")
    return row


def end_sessions(session: Session, row: t.UserRow) -> None:
    """End all sessions of a user immediately."""
    open_ones = (t.SessionRow.user_id == row.id, t.SessionRow.ended_at.is_(None))
    session.execute(update(t.SessionRow).where(*open_ones).values(ended_at=t.now()))


class ExternalUsers(rows.Transactions):
    """Every method is one transaction and blocks. `entry`: of the audit, with user and address."""

    def renew(self, issuer: str, subject: str, name: str, role: Role | None, entry: Entry) -> UserDocument | None:
        """The user, with the role that the provider's groups give now; added at the first login.

        `name` is used only at the first login; if it exists, it belongs to another user. A `role` of None: no group
        gives a role; then existing sessions are ended, no user is added, and the result is None. A user who is
        disabled here stays disabled.
        """
        with self._database.write(quiet=True) as session:
            of_it = (t.UserRow.issuer == issuer, t.UserRow.subject == subject)
            row = session.scalar(select(t.UserRow).where(*of_it))
            if role is None:
                if row is not None:
                    end_sessions(session, row)
                    append(session, [{**entry, "event": "role lost", "user": row.name}])
                return None
            if row is None:
                name = _free_name(session, name, subject)
                added: Entry = {"user": name, "user_role": role.word, "issuer": issuer, "subject": subject}
                append(session, [{**entry, "event": "user added", **added}])
                new = t.UserRow(name=name, role=role, password=None, issuer=issuer, subject=subject)
                row = rows.added(session, new)
            elif row.role != role and row.disabled_at is None:
                row.role = role
                append(session, [{**entry, "event": "role changed", "user": row.name, "user_role": role.word}])
            return rows.document(UserDocument, row)


def _free_name(session: Session, name: str, subject: str) -> str:
    """Raises Conflict if even the name with the subject is in use."""
    try:
        check_free(session, name)
    except Conflict:
        name = unique_name(name, subject)
        check_free(session, name)
    return name


def check_free(session: Session, name: str) -> None:
    """Raises Conflict if a user or key has or had the name: each is used once, so that the audit is unambiguous."""
    for row, who in ((t.ApiKeyRow, "a key of"), (t.UserRow, "a user")):
        if session.scalar(select(row.id).where(row.name == name)) is not None:
            raise Conflict(f"{who} {name} exists or existed: use another name, because the audit needs unique names")


class KeyDocument(BaseModel):
    """A key without its secret."""

    model_config = ConfigDict(frozen=True)
    id: int
    name: str
    role: Role
    scopes: tuple[str, ...] | None = None  # None: everything that the role allows
    created_at: datetime
    expires_at: datetime
    revoked_at: datetime | None

    def trouble(self, at: datetime) -> str:
        """Why it is not valid at this time; empty if it is."""
        if self.revoked_at is not None:
            return f"the key of {self.name} was revoked on {self.revoked_at:%Y-%m-%d}"
        return f"the key of {self.name} expired on {self.expires_at:%Y-%m-%d}" if at >= self.expires_at else ""


class KeyStore(rows.Transactions):
    """Every method is one transaction and blocks. `entry`: of the audit, with user and address."""

    def add(
        self, name: str, role: Role, valid: timedelta, entry: Entry, scopes: Sequence[str] | None = None
    ) -> tuple[KeyDocument, str]:
        """The new key and its secret, which is not stored. Raises Conflict if the name was used before."""
        key = new_key()
        with self._database.write(quiet=True) as session:
            check_free(session, name)
            self._database.keep_time(session)
            made = self._database.now(session)
            limited = None if scopes is None else list(scopes)
            times = {"created_at": made, "expires_at": made + valid}
            new = t.ApiKeyRow(name=name, role=role, scopes=limited, sha256=key_sha256(key), **times)
            row = rows.added(session, new)
            added: dict[str, Fact] = {"event": "key added", "key": name, "key_role": role.word}
            append(session, [{**entry, **added, **({"scopes": limited} if limited else {})}])
            return rows.document(KeyDocument, row), key

    def revoke(self, name: str, entry: Entry) -> KeyDocument:
        """Effective immediately; a second call changes nothing. Raises NotFound."""
        with self._database.write(quiet=True) as session:
            row = session.scalar(select(t.ApiKeyRow).where(t.ApiKeyRow.name == name))
            if row is None:
                raise NotFound(f"key of {name} does not exist; `sweepid people list` lists all keys")
            if row.revoked_at is None:
                row.revoked_at = t.now()
                append(session, [{**entry, "event": "key revoked", "key": name}])
            return rows.document(KeyDocument, row)

    def all(self) -> tuple[KeyDocument, ...]:
        with self._database.read() as session:
            self._database.now(session)  # what the database keeps counts for `now`
            return rows.documents(KeyDocument, session, select(t.ApiKeyRow).order_by(t.ApiKeyRow.id))

    def now(self) -> datetime:
        """The time by which keys expire."""
        return self._database.clock.now()

    def find(self, key: str) -> KeyDocument | None:
        """The key with this secret, including revoked and expired ones."""
        value = key_sha256(key)
        if value is None:
            return None
        with self._database.read() as session:
            row = session.scalar(select(t.ApiKeyRow).where(t.ApiKeyRow.sha256 == value))
            self._database.now(session)
            return None if row is None else rows.document(KeyDocument, row)


LEAST = 12  # characters; NIST SP 800-63B: a minimum length and no rules on the characters

_HASHER = PasswordHasher()


def password_hash(password: str) -> str:
    """The stored text: parameters, salt and hash. BadInput if the password is too short."""
    if len(password) < LEAST:
        raise BadInput("password", f"has {len(password)} characters; use at least {LEAST}, for instance some words")
    return _HASHER.hash(_bytes(password))


def fits(password: str, stored: str | None) -> bool:
    """Whether it is the stored password. None: of an unknown user; takes the same time and never matches."""
    try:
        return _HASHER.verify(stored or _nobodys(), _bytes(password)) and stored is not None
    except (VerificationError, InvalidHashError):
        return False


def outdated(stored: str) -> bool:
    """Whether the library now recommends other parameters."""
    return _HASHER.check_needs_rehash(stored)


def _nobodys() -> str:
    """A hash of zeros with the present parameters; no known password has it."""
    salt, zeros = (base64.b64encode(bytes(n)).decode().rstrip("=") for n in (_HASHER.salt_len, _HASHER.hash_len))
    cost = f"m={_HASHER.memory_cost},t={_HASHER.time_cost},p={_HASHER.parallelism}"
    return f"$argon2id$v=19${cost}${salt}${zeros}"


def _bytes(password: str) -> bytes:
    """The same bytes from every keyboard; JSON may escape half a surrogate pair."""
    return unicodedata.normalize("NFKC", password).encode("utf-8", "surrogatepass")


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
            new = t.SessionRow(user_id=user.id, sha256=key_sha256(token), address=address, created_at=at, seen_at=at)
            row = rows.added(session, new)
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
