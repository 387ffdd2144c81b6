"""The only way to read the samples of a recording, wherever it is: used in workers and to fetch files."""

import tempfile
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

from service.model.errors import BadInput
from service.model.recording import Recording
from service.store.files.atomic_files import place_new
from service.store.files.columns import read_columns
from service.store.files.recordings import FETCHED, RecordingFile, check_file, still_here
from service.store.objects.object_store import MissingObject, ObjectStore, StoreAway


def read_recording(file: RecordingFile) -> Recording:
    """Samples of a recording. Raises BadInput if it is missing or was changed, StoreAway while the store does not
    answer.
    """
    if file.store is None:
        return read_columns(file.path)
    if still_here(file.path):
        check_file(file.path, file.sha256)
        return read_columns(file.path)
    if file.transfer.is_dir():
        bring(file)
        return read_columns(file.path)
    with tempfile.TemporaryDirectory(prefix="sweepid-") as name:  # a worker on another computer
        path = Path(name) / file.path.name
        _fetch(file, path)
        return read_columns(path)


def bring(file: RecordingFile) -> None:
    """Fetch a recording from the store to its path; no effect if it exists. Errors as `read_recording`."""
    partial = file.transfer / f"{FETCHED}{uuid4().hex}"
    _fetch(file, partial)
    try:
        file.path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError):
            place_new(partial, file.path)
    finally:
        partial.unlink(missing_ok=True)


def _fetch(file: RecordingFile, target: Path) -> None:
    if file.store is None:
        raise BadInput(str(file.path), "recording file is missing")
    try:
        ObjectStore(file.store).fetch(file.sha256, target)
    except MissingObject as error:
        if file.was_here:  # not moved yet, and this worker has no access to the service's data folder
            raise StoreAway(f"{error}: the service has not moved it yet") from None
        raise BadInput(str(file.path), f"recording file is missing, and {error.place}: {error.reason}") from None
