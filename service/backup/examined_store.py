"""Recordings that are not in the data folder, as examined by `doctor`: in the object store, or lost."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from service.errors import BadInput
from service.settings.object_store import StoreAddress
from service.store.objects.object_store import MissingObject, ObjectStore, StoreAway, WrongObject
from service.store.snapshot import Contents


@dataclass(frozen=True, slots=True)
class Finding:
    """One error, and what to do."""

    place: str
    what: str
    action: str

    @property
    def line(self) -> str:
        return " ".join(f"{self.place}: {self.what}; {self.action}".split())


def objects_wrong(data_dir: Path, named: Contents, store: StoreAddress | None) -> Iterator[Finding]:
    """Errors of recordings that were moved or are missing here. Every object is read."""
    asked: dict[str, str] = {}
    for path, sha256 in named.files.items():
        if sha256 is None or not is_recording(path):
            continue
        here = (data_dir / path).exists()
        if not here and store is None and path not in named.moved:
            yield Finding(str(data_dir / path), "is missing", f"copy data/{path} of a backup there")
        elif not here or path in named.moved:
            asked[path] = sha256
    if not asked:
        return
    if store is None:
        what = f"{len(asked)} recordings are in an object store, but none is configured"
        yield Finding(str(data_dir), what, "set `recordings_url`")
        return
    try:
        objects = ObjectStore(store)
        for path, sha256 in asked.items():
            yield from _object(objects, data_dir / path, path, sha256)
    except StoreAway as error:
        yield Finding(str(error), f"{len(asked)} recordings could not be checked", "see to the store and run it again")
    except BadInput as error:
        yield Finding(error.place, error.reason, "correct the setting")


def is_recording(path: str) -> bool:
    """True for a recording; its manifest and spectrum stay in the data folder."""
    return path.endswith(".parquet")


def _object(objects: ObjectStore, file: Path, path: str, sha256: str) -> Iterator[Finding]:
    """StoreAway."""
    whole = str(file) if file.exists() else f"data/{path} of a backup"
    try:
        objects.check(sha256)
    except (MissingObject, WrongObject) as error:
        yield Finding(error.place, error.reason, f"copy {whole} there")
