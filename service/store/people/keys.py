"""API keys: created, shown once, looked up by their hash, revoked. Each change is in the audit, in the same
transaction.
"""

from collections.abc import Sequence
from datetime import datetime, timedelta

from pydantic import BaseModel, ConfigDict
from sqlalchemy import select

from service.model.errors import NotFound
from service.store import rows
from service.store import tables as t
from service.store.access.audit_chain import Entry, Fact
from service.store.access.keys import key_sha256, new_key
from service.store.access.permissions import Role
from service.store.database import Transactions
from service.store.people.audit import append
from service.store.people.time import keep
from service.store.people.users import check_free


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


class KeyStore(Transactions):
    """Every method is one transaction and blocks. `entry`: of the audit, with user and address."""

    def add(
        self, name: str, role: Role, valid: timedelta, entry: Entry, scopes: Sequence[str] | None = None
    ) -> tuple[KeyDocument, str]:
        """The new key and its secret, which is not stored. Raises Conflict if the name was used before."""
        key = new_key()
        with self._database.write(quiet=True) as session:
            check_free(session, name)
            keep(session, self._database)
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
