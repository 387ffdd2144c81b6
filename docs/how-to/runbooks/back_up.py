"""A verified backup: search for damage, copy, and test the restore in a temporary folder.

    python back_up.py /mnt/backups/2026-03-01 --by "your name"

Run it on the computer of the service, as its user; the service may run and measure. Exit codes: 0 the backup and its
test restore are complete, 1 damage was found or the disk failed, 2 bad input, 3 ended by a person.
"""

import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from runbook import Exit, Runbook, parser_of, run

from service import BadInput
from service.process.settings import load_settings
from service.store.back_up import DATABASE, make_backup, restore, sqlite_file
from service.store.examination import examine


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("target", type=Path, help="folder to make; must not exist, its parent must")
    parser.add_argument("--config", type=Path, help="settings of the service; default: config/service.yaml")
    parser.add_argument("--data-dir", type=Path, help="database and recordings; default: that of the settings")
    parser.add_argument(
        "--rehearse-in", type=Path, help="folder with enough space for the test restore; default: next to the target"
    )
    return run("back_up", parser, back_up)


def back_up(book: Runbook) -> Exit:
    given = book.given
    settings = load_settings(given.config)
    if given.data_dir is not None:
        settings = settings.model_copy(update={"data_dir": given.data_dir})
    place = given.rehearse_in or given.target.parent
    for name, folder in (("target", given.target.parent), ("--rehearse-in", place)):
        if not folder.is_dir():
            raise BadInput(name, f"folder {folder} does not exist: is the disk mounted?")
    if hasattr(os, "nice"):
        os.nice(10)  # lower priority than the process that streams set-points
    database = sqlite_file(settings.url)
    if found(book, "data folder", database, settings.data_dir, settings.least_free_disk):
        return Exit.FAILED
    if given.dry_run:
        would = f"{settings.data_dir} would be copied to {given.target} and restored once in {place}; moves nothing"
        book.step("backup", would)
        return Exit.DONE
    manifest = make_backup(database, settings.data_dir, given.target)
    book.step(
        "backup", f"{given.target}: {len(manifest.files)} files, {manifest.size} bytes", files=len(manifest.files)
    )
    for stream in manifest.streams_left_out:
        book.step("left out", f"{stream}: a sweep that is being measured")
    with TemporaryDirectory(prefix="rehearsal-", dir=place) as name:
        restored = Path(name) / "data"
        restore(given.target, restored)
        book.step("restored", f"{len(manifest.files)} files, each as it was copied")
        if found(book, "rehearsal", restored / DATABASE, restored, 0):
            return Exit.FAILED
    book.step("rehearsal", "temporary folder removed")
    return Exit.DONE


def found(book: Runbook, what: str, database: Path, data: Path, least_free: int) -> bool:
    """Print the findings in a data folder; returns whether there are any."""
    findings = examine(database, data, least_free)
    for finding in findings:
        book.step(what, finding.line, finding=finding.place)
    if not findings:
        book.step(what, "nothing found")
    return bool(findings)


if __name__ == "__main__":
    sys.exit(main())
