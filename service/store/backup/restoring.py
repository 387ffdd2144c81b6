"""Restores a backup to a data folder for a service."""

import sqlite3
from pathlib import Path

from service.model.errors import BadInput
from service.store.backup.building import PARTIAL, NotCopied, building, copy_file
from service.store.backup.making import DATABASE, check_owner
from service.store.backup.manifest import DATA, Manifest, StoredFile, read_manifest
from service.store.files.recordings import file_sha256
from service.store.snapshot import Contents, contents, integrity, look


def check_backup(backup: Path) -> Manifest:
    """The manifest of a complete backup; otherwise BadInput names the first error."""
    if backup.name.endswith(PARTIAL):
        raise BadInput(str(backup), "is not a complete backup: it was not finished")
    manifest = read_manifest(backup)
    for path, stored in manifest.files.items():
        _check_file(backup / DATA / path, stored)
    place = backup / DATA / DATABASE
    if DATABASE not in manifest.files:
        raise BadInput(str(place), "is not in the manifest")
    try:
        found = look(place, contents)
        wrong = look(place, integrity)
    except sqlite3.Error as error:
        raise BadInput(str(place), f"is not a complete database: {error}") from None
    if wrong:
        raise BadInput(str(place), f"is not a complete database: {wrong[0]}")
    _compare(backup, manifest, found)
    return manifest


def restore(backup: Path, data_dir: Path) -> Manifest:
    """Make `data_dir`, which is new or empty, from a backup, after the complete backup was verified.

    BadInput, and nothing is left, otherwise; NotCopied for disk errors.
    """
    backup, data_dir = backup.resolve(), data_dir.resolve()
    if data_dir.exists() and (not data_dir.is_dir() or any(data_dir.iterdir())):
        raise BadInput(str(data_dir), "exists already and is not an empty folder")
    if data_dir.is_mount():
        raise BadInput(str(data_dir), "is a mount point and cannot be replaced: give a new folder in it")
    manifest = check_backup(backup)
    with building(data_dir) as partial:
        for path, stored in manifest.files.items():
            if copy_file(backup / DATA / path, partial / path) != stored:
                raise NotCopied(f"{backup / DATA / path} changed while it was read: check the disk")
    return manifest


def _check_file(path: Path, stored: StoredFile) -> None:
    try:
        size = path.stat().st_size
        same = size == stored.size and file_sha256(path) == stored.sha256
    except FileNotFoundError:
        raise BadInput(str(path), "is missing: the backup is not complete") from None
    except OSError as error:
        raise BadInput(str(path), f"cannot be read: {error.strerror or error}") from None
    if not same:
        difference = (
            f"{size} bytes instead of {stored.size}" if size != stored.size else f"SHA-256 is not {stored.sha256}"
        )
        raise BadInput(str(path), f"was changed, {difference}: the backup is not complete")


def _compare(backup: Path, manifest: Manifest, found: Contents) -> None:
    """BadInput if database and manifest belong to different backups."""
    check_owner(backup / DATA, found)
    if (found.schema, found.identity) != (manifest.schema_version, manifest.database):
        raise BadInput(
            str(backup), f"the manifest names database {manifest.database}, schema {manifest.schema_version}; the "
                f"backup contains database {found.identity}, schema {found.schema}"
        )  # fmt: skip
    for path, sha256 in found.files.items():
        there = manifest.files[path].sha256 if path in manifest.files else manifest.in_store.get(path)
        if sha256 not in (None, there):
            raise BadInput(
                str(backup), f"{path} is used by the database, but is missing in the manifest or different there"
            )
