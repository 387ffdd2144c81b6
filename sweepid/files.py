"""Files of the commands, read back: documents, torque gains, models with known effects."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar, cast

from pydantic import ConfigDict, Field

from service import BadInput
from service.identification.axis.known_effects import KnownEffects, known_effects
from service.identification.axis.nominal_priors import TorqueGain
from service.identification.estimates.robot_type import RobotType, robot_type
from service.model import Robot
from service.model.configuration import read_text, read_yaml
from service.model.results.diagnosis import Diagnosis
from service.model.results.effect import KnownModel, ModelFile
from service.model.results.estimate import Estimate, Figure
from service.model.results.part import Document, Part

Kind = TypeVar("Kind", bound=Document)

LARGEST = 2**25  # bytes of a document: as empty lists they take 20 times that in memory
MOST_VALUES = 500_000  # of a document, an estimate of 900 sweeps has 100,000: each may be wrong, and is then an error


class Gain(Part):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    value: float = Field(gt=0)
    std: float = Field(ge=0)


class AxisGain(Part):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    gain: Gain
    poses: int | None = None
    added_inertia: float | None = None


class TorqueGains(Part):
    model_config = ConfigDict(frozen=True, extra="forbid")
    axes: dict[str, AxisGain] = Field(min_length=1)


class LagDocument(Part):
    """Of a channel behind position, s; not `apart`: only the total is known."""

    delay: Figure
    smoothing: Figure
    total: Figure
    apart: bool


class AxisChannels(Part):
    """`free_resonance`, Hz, null where none was found."""

    effort: LagDocument
    velocity: LagDocument
    free_resonance: float | None


class ChannelTimings(Part):
    """`sweepid estimate channels --json`, by joint."""

    axes: dict[str, AxisChannels]


def read_gains(path: Path) -> dict[str, TorqueGain]:
    """What `sweepid estimate torque-gain --json` wrote, by joint."""
    found = read_yaml(path, TorqueGains)  # JSON is YAML, too
    return {joint: TorqueGain(axis.gain.value, axis.gain.std) for joint, axis in found.axes.items()}


def gains_of(given: Mapping[str, TorqueGain] | str | Path | None) -> Mapping[str, TorqueGain] | None:
    """By joint, also from a file."""
    return read_gains(Path(given)) if isinstance(given, str | Path) else given


def effects_of(given: Diagnosis | str | Path | None, robot: Robot) -> KnownEffects | None:
    """Of a diagnosis, or from the file of `sweepid diagnose --model`."""
    if given is None:
        return None
    if isinstance(given, str | Path):
        return read_effects(Path(given), robot)
    from service.diagnosis import model_document

    model = KnownModel.read(model_document(robot, given).as_json(), "diagnosis")
    return known_effects(model, robot.joints, ModelFile(file="diagnosis"))


def type_of(given: Sequence[str | Path], robot: Robot) -> RobotType | None:
    """Of files of `sweepid identify --json`; None without any."""
    files = list(map(Path, given))
    return robot_type(robot, {str(path): read_document(path, Estimate) for path in files}) if files else None


def started(robot: Robot, given: Estimate | str | Path) -> Robot:
    """The robot whose nominal model is that of an estimate, also from a file; BadInput if it is of another robot."""
    from service.formats.export.started_robot import started_from

    if isinstance(given, str | Path):
        path = Path(given)
        document = read_document(path, Estimate).as_json()
        source = f"{path.name}, sha256 {hashlib.sha256(path.read_bytes()).hexdigest()}"
        return started_from(robot, document, source, str(path))
    source = f"estimate, sha256 {hashlib.sha256(given.to_json().encode()).hexdigest()}"
    return started_from(robot, given.as_json(), source, "estimate")


def read_effects(path: Path, robot: Robot) -> KnownEffects:
    """What `sweepid diagnose --model` wrote; BadInput names the file."""
    model = read_document(path, KnownModel, f"{path}: model")
    try:
        return known_effects(model, robot.joints, ModelFile(file=path.name))
    except BadInput as error:
        raise BadInput(f"{path}: {error.place}", error.reason) from None


def read_document(path: Path, kind: type[Kind], place: str = "") -> Kind:
    """What another command wrote with `--json`; BadInput (within the file at `place`) if the file does not hold it."""
    try:
        document: object = json.loads(read_text(path, LARGEST))
    except ValueError as error:
        raise BadInput(str(path), f"cannot be read as JSON: {error}") from None
    except RecursionError:
        raise BadInput(str(path), "cannot be read as JSON: nested too deeply") from None
    if not isinstance(document, dict):
        raise BadInput(str(path), "is not a JSON object")
    if not _fits(cast("object", document)):
        raise BadInput(str(path), f"has more than {MOST_VALUES} values, its limit")
    return kind.read(cast("object", document), place or str(path))


def _fits(document: object) -> bool:
    """Without recursion: the values that it holds are at most so many."""
    count, waiting = 0, [document]
    while waiting:
        one = waiting.pop()
        if isinstance(one, dict | list):
            held = cast("list[object]", list(one.values()) if isinstance(one, dict) else one)
            count += len(held)
            if count > MOST_VALUES:
                return False
            waiting += held
    return True
