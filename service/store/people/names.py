"""Names of users and keys: each is used only once, so that the audit is unambiguous."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from service.errors import Conflict
from service.store import tables as t


def check_free(session: Session, name: str) -> None:
    """Raises Conflict if the name is or was in use."""
    for row, who in ((t.ApiKeyRow, "a key of"), (t.UserRow, "a user")):
        if session.scalar(select(row.id).where(row.name == name)) is not None:
            raise Conflict(f"{who} {name} exists or existed: use another name, because the audit needs unique names")
