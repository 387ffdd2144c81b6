"""The database and machine that a data folder belongs to: recordings are only usable with the database that describes
them.

The folder contains the identity that its database got when it was created (`database.json`). Another, lost or
emptied database must not be used with it: it would count campaigns from 1 again, next to the recordings of the other
one.
"""

import json
from pathlib import Path
from uuid import uuid4

from pydantic import BaseModel, ConfigDict, ValidationError
from sqlalchemy import select

from service import BadInput, Conflict
from service.model import Sweep, build_robot
from service.store import tables as t
from service.store.database import Database
from service.store.documents import CampaignDocument, NewSweep
from service.store.files.bundle import Bundle, SavedBundle
from service.store.files.recordings import RecordingFiles, place_new
from service.store.store import COMPLETE, Store
from service.store.table_rows import NoMachine, of_own

OWNER_FILE = "database.json"


class Owner(BaseModel):
    """The database of a data folder, from its file."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    id: str
    database: str  # its address when the folder was claimed, for information
    machine: int  # the id of the machine whose recordings are here


class ForeignFolder(Conflict):
    """The data folder belongs to another database or another machine."""


def claim_folder(folder: Path, database: Database) -> str:
    """Why nothing may be stored in this folder with this database, because it is lost or empty; "" if it may.

    Blocks. A folder without owner belongs to this database from now on. ForeignFolder names both if it belongs to
    another.
    """
    machine = database.machine
    if machine is None:
        raise NoMachine
    with database.read() as session:
        identity = session.scalars(select(t.IdentityRow.id)).one()
        own = Owner(id=identity, database=database.address, machine=machine.id)
        empty = session.scalar(select(t.CampaignRow.id).where(of_own(session)).limit(1)) is None
        names = {row.id: row.name for row in session.scalars(select(t.MachineRow))}
    owner = read_owner(folder)
    measured, imported = (_recordings(folder, kind) for kind in ("campaign-*", "import-*"))
    foreign = owner is None or owner.id != own.id
    # remains of a killed import do not mean that an empty database was lost
    there = measured + imported if foreign else measured
    if empty and there:
        whose = "" if owner is None or not foreign else f" of database {owner.id} (made as {owner.database})"
        return (
            f"database {own.id} ({own.database}) has no campaign of machine {machine.name!r}, but "
            f"{folder} contains {there} recordings{whose}: the database was lost or replaced; restore "
            "it from a backup, or use another data folder"
        )
    if owner is None:
        _write(folder, own)
    elif foreign:
        raise ForeignFolder(
            f"data folder {folder} belongs to database {owner.id} (made as {owner.database}), "
            f"not to database {own.id} ({own.database})"
        )
    elif owner.machine != machine.id:
        raise ForeignFolder(
            f"data folder {folder} belongs to machine {names.get(owner.machine, owner.machine)!r}, not to "
            f"{machine.name!r}: set `machine_name` to its name, or give {machine.name!r} a `data_dir` of its own"
        )
    return ""


def _recordings(folder: Path, kind: str) -> int:
    """Number of recordings, including those whose samples are in an object store: their manifests stay."""
    files = [path for end in ("parquet", "json") for path in (folder / "recordings").glob(f"{kind}/*.{end}")]
    return len({path.with_suffix("") for path in files if ".spectrum-" not in path.name})


def read_owner(folder: Path) -> Owner | None:
    """None for a folder without owner. Raises BadInput if its file cannot be read."""
    place = folder / OWNER_FILE
    try:
        return Owner.model_validate_json(place.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (ValidationError, ValueError):
        raise BadInput(str(place), "does not name the database of the data folder") from None


def _write(folder: Path, owner: Owner) -> None:
    """Complete or not at all, and never over that of another database."""
    partial = folder / f".{OWNER_FILE}.{uuid4().hex}"
    partial.write_text(json.dumps(owner.model_dump()) + "\n", encoding="utf-8")
    try:
        place_new(partial, folder / OWNER_FILE)
    finally:
        partial.unlink(missing_ok=True)


def import_campaign(store: Store, files: RecordingFiles, saved: SavedBundle) -> CampaignDocument:
    """A measured campaign of sweeps whose recordings are in `files`, and which wait for identification.

    If it cannot be stored, the recordings are removed.
    """
    try:
        robot = store.add_robot(build_robot(saved.robot, saved.urdf_text))
        return store.add_measured(robot.id, [NewSweep(spec=spec, mode=None) for spec in saved.sweeps], saved.recordings)
    except BaseException:
        files.remove_folder(saved.folder)
        raise


def campaign_bundle(store: Store, files: RecordingFiles, campaign_id: int) -> Bundle:
    """The complete sweeps of a campaign, as used by the estimate. Raises Conflict if there is none yet."""
    robot = store.robot(store.campaign(campaign_id).robot_id).build()
    sweeps = tuple(Sweep(spec, files.load(one)) for spec, one in store.recorded_sweeps(campaign_id, COMPLETE))
    if not sweeps:
        raise Conflict(f"campaign {campaign_id} has no complete recording yet")
    return Bundle(robot, sweeps)
