"""Where an export takes its estimate from: a bundle, or the file that `sweepid identify --json` wrote."""

from pathlib import Path

import sweepid
from service.model.configuration import read_text
from service.model.errors import BadInput
from service.model.results.estimate import Estimate
from service.model.robot import Robot
from service.store.files.bundle import Bundle
from sweepid.files import LARGEST, read_document


def read_estimate(source: Path, side_file: Path | None) -> tuple[Robot, Estimate, Bundle | None]:
    """Robot, estimate, and the bundle that it was made of here; None: it was read from a file."""
    if source.is_dir():
        bundle = sweepid.read_bundle(source)
        return bundle.robot, sweepid.identify(bundle), bundle
    if side_file is None:
        if not source.exists():  # a misspelt name may be that of a bundle
            read_text(source, LARGEST)
        raise BadInput(
            "--robot", "is required with an estimate, which contains neither geometry nor gear ratios of the robot"
        )
    return sweepid.read_robot(side_file), read_document(source, Estimate), None
