"""Users with passwords or of an identity provider, and API keys. Each change is in the audit, in its transaction.

Passwords: argon2id with the parameters that its library recommends. A hash takes about 0.1 s and 64 MiB: never compute
it on the event loop, and never many at the same time.
"""

import base64
import unicodedata
from collections.abc import Sequence
from datetime import datetime, timedelta

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError
from pydantic import BaseModel, ConfigDict
from sqlalchemy import select, update
from sqlalchemy.orm import Session

from service.model.errors import BadInput, Conflict, NotFound
from service.store import rows, tables as t
from service.store.access.audit_chain import Entry, Fact
from service.store.access.credentials import key_sha256, new_key, unique_name
from service.store.access.permissions import Role
from service.store.people.audit import append


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
            row = t.UserRow(name=name, role=role, password=stored)
            session.add(row)
            append(session, [{**entry, "event": "user added", "user": name, "user_role": role.word}])
            session.flush()
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

    def shut_out(self, name: str, entry: Entry) -> UserDocument:
        """Disable a user immediately, with all sessions; a second call changes nothing. Raises NotFound."""
        with self._database.write(quiet=True) as session:
            row = _row(session, name)
            if row.disabled_at is None:
                row.disabled_at = t.now()
                end_sessions(session, row)
                append(session, [{**entry, "event": "user disabled", "user": name}])
            return rows.document(UserDocument, row)

    def let_in(self, name: str, entry: Entry) -> UserDocument:
        """Enable a disabled user again; ended sessions stay ended. Raises NotFound."""
        with self._database.write(quiet=True) as session:
            row = _row(session, name)
            if row.disabled_at is not None:
                row.disabled_at = None
                append(session, [{**entry, "event": "user enabled", "user": name}])
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
            self._replace(user, stored, password_hash(password))
        return user

    def _replace(self, user: UserDocument, stored: str, anew: str) -> None:
        unchanged = (t.UserRow.id == user.id, t.UserRow.password == stored)  # unless the password was changed meanwhile
        with self._database.write(quiet=True) as session:
            session.execute(update(t.UserRow).where(*unchanged).values(password=anew))


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
                row = self._added(session, issuer, subject, name, role, entry)
            elif row.role != role and row.disabled_at is None:
                row.role = role
                append(session, [{**entry, "event": "role changed", "user": row.name, "user_role": role.word}])
            return rows.document(UserDocument, row)

    def _added(self, session: Session, issuer: str, subject: str, name: str, role: Role, entry: Entry) -> t.UserRow:
        free = _free_name(session, name, subject)
        row = t.UserRow(name=free, role=role, password=None, issuer=issuer, subject=subject)
        session.add(row)
        added: Entry = {"user": free, "user_role": role.word, "issuer": issuer, "subject": subject}
        append(session, [{**entry, "event": "user added", **added}])
        session.flush()
        return row


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
            expires = made + valid
            session.add(
                row := t.ApiKeyRow(
                    name=name,
                    role=role,
                    scopes=limited,
                    sha256=key_sha256(key),
                    created_at=made,
                    expires_at=expires,
                )
            )
            added: dict[str, Fact] = {"event": "key added", "key": name, "key_role": role.word}
            append(session, [{**entry, **added, **({"scopes": limited} if limited else {})}])
            session.flush()
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
