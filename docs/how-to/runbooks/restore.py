"""Restore a backup into a new data folder, check it, and report what the service will find at its start there.

    python restore.py /mnt/backups/2026-03-01 var-restored --by "your name"

Run it on the computer of the service, as its user. Exit codes: 0 the folder is complete, 1 a service still runs, or
damage was found or the disk failed, 2 bad input (no backup, incomplete backup, folder not empty), 3 declined.
"""

import sqlite3
import sys
from pathlib import Path

from runbook import Exit, Runbook, parser_of, run

from service import BadInput
from service.store.back_up import DATABASE, check_backup, look, restore
from service.store.examination import examine
from service.web.client import ServiceUnreachable

NEXT = "sweepid serve --data-dir {}; then after_a_stop.py"


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("backup", type=Path, help="folder that `sweepid data backup` or back_up.py made")
    parser.add_argument("data_dir", type=Path, help="folder to make; must be empty or not exist, its parent must exist")
    return run("restore", parser, restored)


def restored(book: Runbook) -> Exit:
    given = book.given
    target: Path = given.data_dir
    if not target.absolute().parent.is_dir():
        raise BadInput("data_dir", f"folder {target.absolute().parent} does not exist: is the disk mounted?")
    manifest = check_backup(given.backup)
    size = f"{len(manifest.files)} files, {manifest.size} bytes, of {manifest.made_at:%Y-%m-%d %H:%M} UTC"
    book.step("backup", f"complete: {size}", files=len(manifest.files))
    for stream in manifest.streams_left_out:
        book.step("not in the backup", f"{stream}: its sweep will be interrupted")
    if manifest.in_store:
        book.step("object store", f"{len(manifest.in_store)} recordings are only there: set recordings_url")
    running = service_runs(book)
    if given.dry_run:
        book.step("restore", f"{given.backup} would be restored into {target}; moves nothing")
        return Exit.DONE
    if running:
        book.step(
            "restore",
            "not started: two services would command one machine. End the service, then run this script again",
        )
        return Exit.FAILED
    if not book.agreed("Has the service on the old data folder ended for good?", "ended"):
        book.step("restore", "declined")
        return Exit.STOPPED
    restore(given.backup, target)
    book.step("restored", f"{target}: {len(manifest.files)} files, each as in the backup")
    findings = examine(target / DATABASE, target, 0)
    for finding in findings:
        book.step("check", finding.line, finding=finding.place)
    if findings:
        return Exit.FAILED
    book.step("check", "nothing found")
    tell_contents(book, target / DATABASE)
    book.step("next", NEXT.format(target))
    return Exit.DONE


def service_runs(book: Runbook) -> bool:
    """Whether a service answers at --url."""
    try:
        version = book.client.version()
    except ServiceUnreachable:
        book.step("service", f"none answers at {book.given.url}")
        return False
    book.step("service", f"{version} answers at {book.given.url}")
    return True


def tell_contents(book: Runbook, database: Path) -> None:
    """Print the number of campaigns in each state, and that nothing moves automatically after the start."""

    def counted(connection: sqlite3.Connection) -> list[tuple[str, int]]:
        return connection.execute("SELECT state, COUNT(*) FROM campaign GROUP BY state ORDER BY state").fetchall()

    states = dict(look(database, counted))
    told = ", ".join(f"{count} {state}" for state, count in states.items())
    book.step("campaigns", told or "none", campaigns=states)
    if states.keys() & {"running", "pausing"}:
        book.step("after the start", "the running campaign is paused; nothing moves until a person resumes it")


if __name__ == "__main__":
    sys.exit(main())
