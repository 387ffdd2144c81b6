"""The data check of a bundle that is imported, in a process of its own."""

from pathlib import Path

from service.cli.recordings.check import as_lines
from service.data_check import check
from service.store.files.bundle import read_from


def findings_of(source: Path, folder: Path) -> list[str]:
    """What a check of the data finds, one line each; a zip is unpacked into `folder`."""
    measured = read_from(source, folder)
    return as_lines(check(measured.robot, measured.sweeps))
