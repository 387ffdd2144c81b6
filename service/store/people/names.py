"""Names of people and of keys: each is given once, to one of them, so that the audit is clear."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from service.errors import Conflict
from service.store import tables as t


def check_free(session: Session, name: str) -> None:
    """Conflict where somebody bears it, or did."""
    for row, who in ((t.ApiKeyRow, "a key of"), (t.UserRow, "a user")):
        if session.scalar(select(row.id).where(row.name == name)) is not None:
            raise Conflict(f"there is or was {who} {name}; a name is given once, so that the audit is clear")
