"""Recording files under the data directory.

A recording is there whole or not at all: it is written beside its place, synced to the disk, and renamed. Its
manifest (same name, ``.json``) tells what it is without the database. The stream that a sweep is recorded into
(``.arrows``) lies in the same folder until the recording's row is in the store.
"""

import hashlib
import itertools
import json
import os
import re
import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from pydantic import JsonValue

from service.errors import BadInput
from service.recording import Recording
from service.results.identified.manifest import Facts
from service.store.documents import NewRecording, RecordingDocument, RecordingState, SpectrumRecord
from service.store.files.columns import read_columns, write_columns
from service.store.files.placing import place, place_folder, place_new
from service.store.files.spectra import Document, SpectrumFile, encode_spectrum

_STREAM = re.compile(r"campaign-(\d+)/(\d+)-(\d+)\.arrows")


@dataclass(frozen=True, slots=True)
class Run:
    """One attempt at one sweep."""

    campaign_id: int
    number: int
    attempt: int


class RecordingFiles:
    """Names, writes and reads the files; paths in documents are relative to the data directory."""

    def __init__(self, data_dir: Path) -> None:
        self._root = data_dir

    def disk_trouble(self, least: int) -> str:
        """Why no recording could be written now: less than `least` bytes free, or read-only; empty if it could."""
        try:
            free = shutil.disk_usage(self._root).free
        except OSError as error:
            return f"data folder: {error}"
        if not os.access(self._root, os.W_OK):
            return f"data folder {self._root} cannot be written"
        return f"{free} bytes free in {self._root}, limit {least} bytes" if free < least else ""

    def stream(self, run: Run) -> Path:
        """Where the samples of a run go as they come; the folder is made."""
        folder = self._root / "recordings" / f"campaign-{run.campaign_id:06d}"
        folder.mkdir(parents=True, exist_ok=True)
        return folder / f"{run.number:04d}-{run.attempt}.arrows"

    def last_attempt(self, campaign_id: int, number: int) -> int:
        """The highest attempt at a sweep of which a file lies there, also one that the database forgot; 0 if none."""
        name = re.compile(rf"{number:04d}-(\d+)\.")
        found = map(name.match, os.listdir(self.stream(Run(campaign_id, number, 0)).parent))
        return max((int(match.group(1)) for match in found if match), default=0)

    def put_aside(self, stream: Path, why: str) -> Path:
        """Keep a stream that makes no recording under a name that nobody takes for one; the new path."""
        aside = stream.with_name(f"{stream.name}.{why}")
        for number in itertools.count(2):
            if not aside.exists():
                break
            aside = stream.with_name(f"{stream.name}.{why}.{number}")
        return stream.rename(aside)

    def streams(self) -> dict[Run, Path]:
        """The streams that lie about: of the sweep that runs, or left by a crash."""
        found: dict[Run, Path] = {}
        for path in sorted((self._root / "recordings").glob("campaign-*/*.arrows")):
            match = _STREAM.fullmatch(f"{path.parent.name}/{path.name}")
            if match:
                campaign_id, number, attempt = (int(group) for group in match.groups())
                found[Run(campaign_id, number, attempt)] = path
        return found

    def transfer(self) -> Path:
        """Where bundles are unpacked (`import-*`) and packed (`export-*`), each in a folder of its own that goes again.

        It is made if need be.
        """
        path = self._root / "transfer"
        path.mkdir(parents=True, exist_ok=True)
        return path

    def clear_transfer(self) -> None:
        """Remove what transfers left that were killed; to be called before any begins."""
        for kind in ("import-*", "export-*"):
            for folder in self.transfer().glob(kind):
                shutil.rmtree(folder)

    def folder(self, name: str) -> Path:
        """A folder for recordings that were made elsewhere."""
        path = self._root / "recordings" / name
        path.mkdir(parents=True)
        return path

    def take_over(self, other: Path, name: str) -> None:
        """The folder that another data folder on this file system has by this name: all of it or nothing."""
        target = self._root / "recordings" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        place_folder(other / "recordings" / name, target)

    def remove_folder(self, name: str) -> None:
        """Of recordings that nobody knows."""
        shutil.rmtree(self._root / "recordings" / name)

    def path(self, document: RecordingDocument) -> Path:
        return self._root / document.path

    def save(self, path: Path, recording: Recording, state: RecordingState, facts: Facts) -> NewRecording:
        """Write a recording (Parquet) and its manifest with `facts`. OSError if the disk does not take it.

        What lies there already is never overwritten: the new one then has a number after its name.
        """
        partial = path.with_name(f".{path.stem}.partial.parquet")
        try:
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

    def save_spectrum(self, recording: str, document: Document) -> SpectrumRecord:
        """Write the spectrum of a recording (its path in documents) beside it; one that is there is left as it is."""
        content, sha256 = encode_spectrum(document)
        path = (self._root / recording).with_suffix(f".spectrum-{sha256[:16]}.json")
        if not path.exists() or file_sha256(path) != sha256:
            partial = path.with_name(f".{path.name}.partial")
            partial.write_bytes(content)
            place(partial, path)
        return SpectrumRecord(path=path.relative_to(self._root).as_posix(), sha256=sha256)

    def spectrum(self, record: SpectrumRecord) -> SpectrumFile:
        """Where it is to be read."""
        return SpectrumFile(self._root.absolute() / record.path, record.sha256)

    def manifest(self, document: RecordingDocument) -> dict[str, JsonValue]:
        """What is told of a recording beside its samples; empty if the file is gone, BadInput if it cannot be read."""
        path = self.path(document).with_suffix(".json")
        try:
            told: object = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return {}
        except ValueError as error:
            raise BadInput(str(path), f"cannot be read: {error}") from None
        if not isinstance(told, dict):
            raise BadInput(str(path), "is not a JSON object")
        return cast("dict[str, JsonValue]", told)

    def load(self, document: RecordingDocument) -> Recording:
        """The samples of a recording; BadInput if the file is not what was written."""
        self.check(document)
        return read_columns(self.path(document))

    def check(self, document: RecordingDocument) -> None:
        """BadInput unless the file is there as it was written."""
        path = self.path(document)
        if not path.exists():
            raise BadInput(str(path), "recording file is missing")
        if file_sha256(path) != document.sha256:
            raise BadInput(str(path), f"recording file was changed, SHA-256 is not {document.sha256}")


def _place_beside(partial: Path, path: Path) -> Path:
    """Bring a finished file to `path`, or to the first name like it that is free."""
    for number in itertools.count(2):
        if not path.with_suffix(".json").exists():
            with suppress(FileExistsError):
                place_new(partial, path)
                break
        path = path.with_name(f"{path.name.split('.')[0]}.{number}{path.suffix}")
    return path


def file_sha256(path: Path) -> str:
    """Of its content, as rows and manifests have it."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
