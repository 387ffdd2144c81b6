"""Recording files under the data directory.

A recording is always complete: it is written to a temporary file, synced to the disk, and renamed. Its
manifest (same name, ``.json``) describes it without the database. The stream that a sweep is recorded into
(``.arrows``) is in the same folder until the row of the recording is in the store.

If an object store is configured, a recording may be only there; its manifest stays. To read its samples, get
the file from `RecordingFiles.local` (in the service) or from `RecordingFile` (in a job), never by its path only.
"""

import hashlib
import itertools
import json
import os
import re
import shutil
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import cast
from uuid import uuid4

from pydantic import JsonValue

from service import BadInput
from service.model import Recording
from service.model.results.spectrum import AnySpectrum, Facts
from service.process.settings import StoreAddress
from service.store.documents import NewRecording, RecordingDocument, RecordingState, SpectrumRecord


def place_new(partial: Path, path: Path) -> None:
    """As `place`, but raises FileExistsError, and changes nothing, if the path exists."""
    sync(partial)
    try:
        os.link(partial, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without links: the name is reserved first
        path.open("xb").close()
        partial.replace(path)
    partial.unlink(missing_ok=True)
    sync(path.parent)


def place(partial: Path, path: Path) -> None:
    """Move a finished file to its path so that after a power failure the whole file or none exists."""
    sync(partial)
    partial.replace(path)
    sync(path.parent)


def place_folder(partial: Path, path: Path) -> None:
    """As `place`, for a folder whose files are on disk."""
    partial.rename(path)
    sync(path.parent)


def check_new(folder: Path) -> None:
    """BadInput unless there is no such folder, or an empty one."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise BadInput(str(folder), "exists already and is not an empty folder")


@contextmanager
def new_folder(folder: Path) -> Generator[Path]:
    """A folder beside `folder`, new or empty, that takes its place at the end of the block. If that raises, it is
    removed.
    """
    check_new(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    partial = folder.parent / f".{folder.name[:100]}.{uuid4().hex}.partial"
    try:
        partial.mkdir()
        yield partial
        if folder.exists():
            folder.rmdir()  # Windows does not rename to an existing directory, even an empty one
        partial.rename(folder)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise


def sync(path: Path) -> None:
    """The content written to a file or folder is on disk when this returns."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def file_sha256(path: Path) -> str:
    """Hash of the content, as in rows and manifests."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@dataclass(frozen=True, slots=True)
class SpectrumFile:
    """Path of a spectrum document, and the SHA-256 of the file."""

    path: Path
    sha256: str


def encode_spectrum(document: AnySpectrum) -> tuple[bytes, str]:
    """The content of a spectrum's file and its SHA-256. Floats are stored without loss."""
    content = json.dumps(document, allow_nan=False, separators=(",", ":")).encode()
    return content, hashlib.sha256(content).hexdigest()


def read_spectrum(file: SpectrumFile) -> AnySpectrum:
    """The document. Raises BadInput if the file is missing or was changed."""
    try:
        content = file.path.read_bytes()
    except FileNotFoundError:
        raise BadInput(str(file.path), "spectrum file is missing") from None
    if hashlib.sha256(content).hexdigest() != file.sha256:
        raise BadInput(str(file.path), f"spectrum file was changed, SHA-256 is not {file.sha256}")
    return json.loads(content)


@dataclass(frozen=True, slots=True)
class SweepAttempt:
    """One attempt at one sweep."""

    campaign_id: int
    number: int
    attempt: int


@dataclass(frozen=True, slots=True)
class RecordingFile:
    """Reference to a recording for a job: `path` (absolute) is read if it exists, otherwise the object with its hash.

    `was_here`: it was in the data folder when this was created, so that the store may not have it yet. A fetched
    file is moved to the data folder through `transfer`, if that exists, and is temporary elsewhere.
    """

    path: Path
    sha256: str
    transfer: Path
    store: StoreAddress | None
    was_here: bool


Fetch = Callable[[RecordingFile], None]


class RecordingFiles:
    """Names, writes and reads the files; paths in documents are relative to the data directory.

    `store`: object store that may have recordings as well, from which `fetch` brings one to its path.
    """

    fetched = "fetch-"  # prefix of the name of a file from the object store

    def __init__(self, data_dir: Path, store: StoreAddress | None = None, fetch: Fetch | None = None) -> None:
        self._root, self._store, self._fetch = data_dir, store, fetch

    def free_disk(self) -> int | None:
        """Free bytes on the disk of the data folder; None if unknown."""
        try:
            return shutil.disk_usage(self._root).free
        except OSError:
            return None

    def disk_trouble(self, least: int) -> str:
        """Why no recording could be written now: less than `least` bytes free, or read-only; empty if it could."""
        try:
            free = shutil.disk_usage(self._root).free
        except OSError as error:
            return f"data folder: {error}"
        if not os.access(self._root, os.W_OK):
            return f"data folder {self._root} cannot be written"
        return f"{free} bytes free in {self._root}, limit {least} bytes" if free < least else ""

    def stream(self, run: SweepAttempt) -> Path:
        """Path for the samples of a run as they arrive; creates the folder."""
        folder = self._root / "recordings" / f"campaign-{run.campaign_id:06d}"
        folder.mkdir(parents=True, exist_ok=True)
        return folder / f"{run.number:04d}-{run.attempt}.arrows"

    def last_attempt(self, campaign_id: int, number: int) -> int:
        """The highest attempt at a sweep with a file in the folder, also if the database lacks it; 0 if none."""
        name = re.compile(rf"{number:04d}-(\d+)\.")
        found = map(name.match, os.listdir(self.stream(SweepAttempt(campaign_id, number, 0)).parent))
        return max((int(match.group(1)) for match in found if match), default=0)

    def put_aside(self, stream: Path, why: str) -> Path:
        """Rename a stream without a usable recording, so that it is not read again; returns the new path."""
        aside = stream.with_name(f"{stream.name}.{why}")
        for number in itertools.count(2):
            if not aside.exists():
                break
            aside = stream.with_name(f"{stream.name}.{why}.{number}")
        return stream.rename(aside)

    def streams(self) -> dict[SweepAttempt, Path]:
        """Existing streams: that of the running sweep, or those left by a crash."""
        found: dict[SweepAttempt, Path] = {}
        for path in sorted((self._root / "recordings").glob("campaign-*/*.arrows")):
            match = re.fullmatch(r"campaign-(\d+)/(\d+)-(\d+)\.arrows", f"{path.parent.name}/{path.name}")
            if match:
                campaign_id, number, attempt = (int(group) for group in match.groups())
                found[SweepAttempt(campaign_id, number, attempt)] = path
        return found

    def transfer(self) -> Path:
        """Folder in which bundles are unpacked (`import-*`) and packed (`export-*`), each in a temporary folder.

        Created if necessary.
        """
        path = self._root / "transfer"
        path.mkdir(parents=True, exist_ok=True)
        return path

    def clear_transfer(self) -> None:
        """Remove the remains of killed transfers; call it before any begins."""
        for kind in ("import-*", "export-*"):
            for folder in self.transfer().glob(kind):
                shutil.rmtree(folder)
        for file in self.transfer().glob(f"{RecordingFiles.fetched}*"):
            file.unlink(missing_ok=True)

    def folder(self, name: str) -> Path:
        """A folder for imported recordings."""
        path = self._root / "recordings" / name
        path.mkdir(parents=True)
        return path

    def take_over(self, other: Path, name: str) -> None:
        """Move a folder of this name from another data folder on this file system: all of it or nothing."""
        target = self._root / "recordings" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        place_folder(other / "recordings" / name, target)

    def remove_folder(self, name: str) -> None:
        """Remove a folder of unknown recordings."""
        shutil.rmtree(self._root / "recordings" / name)

    def path(self, document: RecordingDocument) -> Path:
        return self._root / document.path

    def save(self, path: Path, recording: Recording, state: RecordingState, facts: Facts) -> NewRecording:
        """Write a recording (Parquet) and its manifest with `facts`. Raises OSError if it cannot be written.

        An existing file is never overwritten: the new one then gets a number after its name.
        """
        partial = path.with_name(f".{path.stem}.partial.parquet")
        try:
            from service.store.files.columns import write_columns  # Arrow: not for who names files only

            write_columns(partial, recording)
            sha256 = file_sha256(partial)
            path = _place_beside(partial, path)
        finally:
            partial.unlink(missing_ok=True)
        relative = path.relative_to(self._root).as_posix()
        new = NewRecording(state=state, path=relative, sha256=sha256, samples=len(recording.time))
        manifest = {**facts, **new.model_dump(mode="json"), "path": path.name}
        partial.write_text(json.dumps(manifest, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        place_new(partial, path.with_suffix(".json"))
        return new

    def save_spectrum(self, recording: str, document: AnySpectrum) -> SpectrumRecord:
        """Write the spectrum of a recording (its path in documents) next to it; an existing one is not changed."""
        content, sha256 = encode_spectrum(document)
        path = (self._root / recording).with_suffix(f".spectrum-{sha256[:16]}.json")
        if not path.exists() or file_sha256(path) != sha256:
            partial = path.with_name(f".{path.name}.partial")
            partial.write_bytes(content)
            place(partial, path)
        return SpectrumRecord(path=path.relative_to(self._root).as_posix(), sha256=sha256)

    def spectrum(self, record: SpectrumRecord) -> SpectrumFile:
        """Reference to the spectrum file."""
        return SpectrumFile(self._root.absolute() / record.path, record.sha256)

    def manifest(self, document: RecordingDocument) -> dict[str, JsonValue]:
        """Manifest of a recording; empty if the file is missing, BadInput if it cannot be read."""
        path = self.path(document).with_suffix(".json")
        try:
            content: object = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return {}
        except ValueError as error:
            raise BadInput(str(path), f"cannot be read: {error}") from None
        if not isinstance(content, dict):
            raise BadInput(str(path), "is not a JSON object")
        return cast("dict[str, JsonValue]", content)

    def load(self, document: RecordingDocument) -> Recording:
        """The samples of a recording. Raises BadInput if the file was changed, NotNow as `local`."""
        from service.store.files.columns import read_columns

        return read_columns(self.local(document))

    def local(self, document: RecordingDocument) -> Path:
        """Local path of a recording as it was written, fetched from the store if it is only there.

        Raises BadInput if it is missing or was changed, here or in the store; NotNow while the store does not
        answer.
        """
        path = self._kept(document)
        if self._store is not None and self._fetch is not None and not still_here(path):
            self.transfer()
            self._fetch(self.reference(document))
        check_file(path, document.sha256)
        return path

    def named(self, document: RecordingDocument) -> RecordingFile:
        """The recording for a job. BadInput unless the file is unchanged here, or there is a store to fetch it from."""
        file = self.reference(document)
        if file.was_here:
            check_file(file.path, document.sha256)
        elif self._store is None:
            raise _missing(self.path(document))
        return file

    def reference(self, document: RecordingDocument) -> RecordingFile:
        """As `named`, without reading the file. Raises BadInput if its samples were removed."""
        path = self._kept(document).absolute()
        return RecordingFile(path, document.sha256, (self._root / "transfer").absolute(), self._store, path.exists())

    def _kept(self, document: RecordingDocument) -> Path:
        """Raises BadInput if the retention rule has removed the samples."""
        path = self.path(document)
        if document.pruned_at is not None:
            raise BadInput(
                str(path), f"samples were removed on {document.pruned_at:%Y-%m-%d} by the rule `keep_samples_days`"
            )
        return path


def check_file(path: Path, sha256: str) -> None:
    """Raises BadInput unless the file exists as it was written."""
    try:
        found = file_sha256(path)
    except FileNotFoundError:
        raise _missing(path) from None
    if found != sha256:
        raise BadInput(str(path), f"recording file was changed, SHA-256 is not {sha256}")


def still_here(path: Path) -> bool:
    """Whether the file of a recording that the store may also have is here; it is then kept for a while."""
    try:
        os.utime(path)
    except FileNotFoundError:
        return False
    return True


def _missing(path: Path) -> BadInput:
    return BadInput(str(path), "recording file is missing")


def _place_beside(partial: Path, path: Path) -> Path:
    """Move a finished file to `path`, or to the first similar name that is free."""
    for number in itertools.count(2):
        if not path.with_suffix(".json").exists():
            with suppress(FileExistsError):
                place_new(partial, path)
                break
        path = path.with_name(f"{path.name.split('.')[0]}.{number}{path.suffix}")
    return path
