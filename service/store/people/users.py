"""People with passwords: added, changed, disabled. The audit has each change, in the same transaction."""

from datetime import datetime

from pydantic import BaseModel, ConfigDict
from sqlalchemy import select, update
from sqlalchemy.orm import Session

from service.errors import Conflict, NotFound
from service.people.chain import Entry
from service.people.passwords import fits, outdated, password_hash
from service.people.permissions import Role
from service.store import tables as t
from service.store.database import Database
from service.store.people.audit import append
from service.store.people.names import check_free


class UserDocument(BaseModel):
    """A person without the password."""

    model_config = ConfigDict(frozen=True)
    id: int
    name: str
    role: Role
    created_at: datetime
    disabled_at: datetime | None

    @property
    def trouble(self) -> str:
        """Why nobody logs in as this one; empty if somebody may."""
        return "" if self.disabled_at is None else f"{self.name} was disabled on {self.disabled_at:%Y-%m-%d}"


class UserStore:
    """Every method is one transaction and blocks; those with a password reckon for some 0.1 s.

    `entry`: of the audit, who does it and from where.
    """

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, name: str, role: Role, password: str, entry: Entry) -> UserDocument:
        """BadInput for a password that is too short; Conflict where the name was given before."""
        stored = password_hash(password)
        with self._database.write(quiet=True) as session:
            check_free(session, name)
            row = t.UserRow(name=name, role=role.word, password=stored)
            session.add(row)
            append(session, [{**entry, "event": "user added", "user": name, "user_role": role.word}])
            session.flush()
            return user_document(row)

    def change_password(self, name: str, password: str, entry: Entry) -> UserDocument:
        """Ends the sessions under the old one. BadInput; NotFound; Conflict for one who is disabled."""
        stored = password_hash(password)
        with self._database.write(quiet=True) as session:
            row = _row(session, name)
            if row.disabled_at is not None:
                raise Conflict(f"{user_document(row).trouble}: add a user with another name")
            row.password = stored
            _end_sessions(session, row)
            append(session, [{**entry, "event": "password changed", "user": name}])
            return user_document(row)

    def shut_out(self, name: str, entry: Entry) -> UserDocument:
        """At once, with all sessions; again changes nothing. NotFound."""
        with self._database.write(quiet=True) as session:
            row = _row(session, name)
            if row.disabled_at is None:
                row.disabled_at = t.now()
                _end_sessions(session, row)
                append(session, [{**entry, "event": "user disabled", "user": name}])
            return user_document(row)

    def all(self) -> tuple[UserDocument, ...]:
        with self._database.read() as session:
            return tuple(user_document(row) for row in session.scalars(select(t.UserRow).order_by(t.UserRow.id)))

    def knows(self, name: str) -> bool:
        with self._database.read() as session:
            return session.scalar(select(t.UserRow.id).where(t.UserRow.name == name)) is not None

    def check(self, name: str, password: str) -> UserDocument | None:
        """Who that is; None for a wrong password, an unknown name or one who is disabled, all of which take as long.

        A hash of parameters that are no longer the library's is replaced.
        """
        with self._database.read() as session:
            row = session.scalar(select(t.UserRow).where(t.UserRow.name == name))
            stored, user = (None, None) if row is None else (row.password, user_document(row))
        if not fits(password, stored) or user is None or stored is None or user.trouble:
            return None
        if outdated(stored):
            self._replace(user, stored, password_hash(password))
        return user

    def _replace(self, user: UserDocument, stored: str, anew: str) -> None:
        unchanged = (t.UserRow.id == user.id, t.UserRow.password == stored)  # nobody changed the password meanwhile
        with self._database.write(quiet=True) as session:
            session.execute(update(t.UserRow).where(*unchanged).values(password=anew))


def user_document(row: t.UserRow) -> UserDocument:
    return UserDocument(
        id=row.id,
        name=row.name,
        role=Role[row.role.upper()],
        created_at=row.created_at,
        disabled_at=row.disabled_at,
    )


def _row(session: Session, name: str) -> t.UserRow:
    row = session.scalar(select(t.UserRow).where(t.UserRow.name == name))
    if row is None:
        raise NotFound(f"no user {name}; `sweepid people list` tells who there is")
    return row


def _end_sessions(session: Session, row: t.UserRow) -> None:
    open_ones = (t.SessionRow.user_id == row.id, t.SessionRow.ended_at.is_(None))
    session.execute(update(t.SessionRow).where(*open_ones).values(ended_at=t.now()))
