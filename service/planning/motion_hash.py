"""One hash of everything that determines the motion of a plan; an approval is valid only for this hash."""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import cast

from service.model.configuration import Cell
from service.process.settings import Settings
from service.store.documents import PlanRecord, RobotDocument


def motion_sha256(plan: PlanRecord, robot: RobotDocument, cell: Cell, settings: Settings, machine: str) -> str:
    """SHA-256 of plan, robot, cell, tolerance, program, name of the machine and `machine` (see `machine_sha256`),
    hexadecimal.
    """
    content = {
        "plan": plan.document,
        "robot": robot.sha256,
        "cell": cell.model_dump(mode="json"),
        "pose_tolerance": settings.pose_tolerance,
        "machine": machine,
        "machine_name": settings.machine_name,
        "program": version("sweepid"),
    }
    return _sha256(content)


def machine_sha256(profile: object, base: Path) -> str:
    """SHA-256 of a drive profile and of each file that it names (EDS, device map, registers), below `base`."""
    named = [text for text in _texts(profile) if _file(base, text)]
    return _sha256(profile, [hashlib.sha256((base / text).read_bytes()).hexdigest() for text in named])


def _texts(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list | tuple):
        parts = cast("Iterable[object]", value.values() if isinstance(value, Mapping) else value)
        for part in parts:
            yield from _texts(part)


def _file(base: Path, text: str) -> bool:
    try:
        return (base / text).is_file()
    except (OSError, ValueError):  # the text is too long for a name, or contains a zero byte
        return False


def _sha256(*content: object) -> str:
    """SHA-256 in the order of the content: keys of a profile may be of several types, which cannot be sorted."""
    return hashlib.sha256(json.dumps(content, default=str).encode()).hexdigest()
