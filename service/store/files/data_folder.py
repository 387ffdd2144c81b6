"""Which database a data folder belongs to: recordings are only worth what the database knows of them.

The folder bears the name that its database was given when it was made (`database.json`). Another database, a lost or an
emptied one must not be taken for it: it would count campaigns from 1 again, beside the recordings of the other.
"""

import json
from pathlib import Path
from uuid import uuid4

from pydantic import BaseModel, ConfigDict, ValidationError
from sqlalchemy import select

from service.errors import BadInput, Conflict
from service.store import tables as t
from service.store.database import Database
from service.store.files.placing import place_new

FILE = "database.json"


class Owner(BaseModel):
    """What a data folder says of its database."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    id: str
    database: str  # its address when the folder was taken, for people to read


class ForeignFolder(Conflict):
    """The data folder is another database's."""


def claim_folder(folder: Path, database: Database) -> str:
    """Why nothing may be stored in this folder with this database, because it is a lost or empty one; "" if it may.

    Blocks. A folder that is nobody's is this database's from here on. ForeignFolder names both where it is another's.
    """
    with database.read() as session:
        own = Owner(id=session.scalars(select(t.IdentityRow.id)).one(), database=database.address)
        empty = session.scalar(select(t.CampaignRow.id).limit(1)) is None
    owner = read_owner(folder)
    measured = sum(1 for _ in (folder / "recordings").glob("campaign-*/*.parquet"))
    imported = sum(1 for _ in (folder / "recordings").glob("import-*/*.parquet"))
    foreign = owner is None or owner.id != own.id
    # what an import left that was killed does not make an empty database a lost one
    there = measured + imported if foreign else measured
    if empty and there:
        whose = "" if owner is None or not foreign else f" of database {owner.id} (made as {owner.database})"
        return (
            f"database {own.id} ({own.database}) knows no campaign, but {folder} holds {there} recordings{whose}: "
            "it was lost or is another one; restore it from a backup, or give it a data folder of its own"
        )
    if owner is None:
        _write(folder, own)
    elif foreign:
        raise ForeignFolder(
            f"data folder {folder} belongs to database {owner.id} (made as {owner.database}), "
            f"not to database {own.id} ({own.database})"
        )
    return ""


def read_owner(folder: Path) -> Owner | None:
    """None for a folder that is nobody's; BadInput if its file cannot be read."""
    place = folder / FILE
    try:
        return Owner.model_validate_json(place.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (ValidationError, ValueError):
        raise BadInput(str(place), "does not say which database the data folder belongs to") from None


def _write(folder: Path, owner: Owner) -> None:
    """Whole or not at all, and never over another's."""
    partial = folder / f".{FILE}.{uuid4().hex}"
    partial.write_text(json.dumps(owner.model_dump()) + "\n", encoding="utf-8")
    try:
        place_new(partial, folder / FILE)
    finally:
        partial.unlink(missing_ok=True)
