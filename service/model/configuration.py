"""Reads the YAML files of ``config/`` into frozen pydantic models; BadInput names the invalid field."""

from collections.abc import Iterator
from difflib import get_close_matches
from pathlib import Path
from typing import TypeVar, cast, get_args

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.bounded_yaml import NO_VALUE, BoundedLoader
from service import BadInput
from service.model.robot import Robot, RobotDescription, robot_from_outside

Model = TypeVar("Model", bound=BaseModel)

LARGEST_YAML = 2**20  # bytes
LARGEST_TEXT = 2**26  # bytes


def read_yaml(path: Path, kind: type[Model]) -> Model:
    """The file as a `kind`; BadInput names file, field and value."""
    try:
        content: object = yaml.load(read_text(path, LARGEST_YAML), Loader=BoundedLoader)
    except yaml.YAMLError as error:
        raise BadInput(str(path), f"not YAML: {' '.join(str(error).split())}") from None
    except NO_VALUE as error:
        raise BadInput(str(path), f"not YAML: a value is not of its type: {error}") from None
    if isinstance(content, dict):
        for key in cast("dict[object, object]", content):
            if not isinstance(key, str):  # settings use keys as keyword arguments
                raise BadInput(str(path), f"key {key!r} is not text")
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        raise bad_field(str(path), error, kind) from None


def read_robot(path: Path) -> Robot:
    """A robot from its side file (``config/robots/*.yaml``) and the URDF in it, relative to the side file."""
    description = read_yaml(path, RobotDescription)
    urdf = path.parent / description.urdf
    return robot_from_outside(description, read_text(urdf), str(path))


def read_text(path: Path, largest: int = LARGEST_TEXT) -> str:
    """The UTF-8 text of a user's file; BadInput if it cannot be read or has more than `largest` bytes."""
    try:
        with path.open("rb") as file:
            content = file.read(largest + 1)
        if len(content) > largest:
            raise BadInput(str(path), f"is larger than {largest} bytes")
        return content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except FileNotFoundError as error:
        raise BadInput(str(path), f"cannot be read: {error.strerror}{_beside(path)}") from None
    except OSError as error:
        raise BadInput(str(path), f"cannot be read: {error.strerror or error}") from None
    except ValueError as error:  # a NUL in the name, or bytes that are not UTF-8
        raise BadInput(str(path), f"cannot be read: {error}") from None


def bad_field(place: str, error: ValidationError, kind: type[BaseModel] | None = None) -> BadInput:
    """The first error of pydantic, with the path to the field and its value.

    `kind`: the model that did not accept the content; for an unknown key, the message then suggests a similar one.
    """
    errors = error.errors(include_url=False)
    unknown = (one for one in errors if one["type"] == "extra_forbidden")  # more useful than a missing key
    first = errors[0] if kind is None else next(unknown, errors[0])
    field = ".".join(str(part) for part in first["loc"])
    given = repr(first["input"])
    shown = "" if len(given) > 60 or first["type"] == "missing" else f", got {given}"
    if kind is not None and first["type"] == "extra_forbidden":
        close = get_close_matches(str(first["loc"][-1]), sorted(set(_keys(kind, set()))), n=1)
        meant = f"; did you mean {close[0]}?" if close else ""
        return BadInput(f"{place} {field}".strip(), f"unknown key{meant}")
    return BadInput(f"{place} {field}".strip(), f"{first['msg']}{shown}")


def _keys(kind: object, seen: set[object]) -> Iterator[str]:
    """Keys of a model and of all models in it."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        if kind in seen:
            return
        seen.add(kind)
        for name, field in kind.model_fields.items():
            yield name
            yield from _keys(field.annotation, seen)
    for part in cast("tuple[object, ...]", get_args(kind)):
        yield from _keys(part, seen)


def _beside(path: Path) -> str:
    """Files that the user may have meant: those in the same folder with the same suffix."""
    most_told = 12  # files
    try:
        there = sorted(one.name for one in path.parent.iterdir() if one.suffix == path.suffix)
    except OSError:
        return ""
    return f"; {path.parent} has {', '.join(there[:most_told])}" if there else ""


class Box(BaseModel):
    """A box obstacle: `size` are the full edge lengths, m; `yaw` turns it about the vertical, rad."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    name: str = Field(min_length=1)
    center: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw: float = 0.0


class Cell(BaseModel):
    """The obstacles and distances for a robot.

    `clearance`: smallest distance between the robot and any obstacle, or between its own links, m.
    `joint_margin`: distance kept from every joint limit, rad (m).
    `ignored_pairs`: pairs of links that are close by construction (neighbours are always ignored).
    `home`: rest position by joint, rad (m); 0 for joints not listed.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    name: str = Field(min_length=1)
    clearance: float = Field(default=0.03, gt=0)
    joint_margin: float = Field(default=0.02, ge=0)
    floor: float | None = None  # height of the floor, m; None: there is none
    boxes: tuple[Box, ...] = ()
    ignored_pairs: tuple[tuple[str, str], ...] = ()
    home: dict[str, float] = {}

    def home_pose(self, joints: tuple[str, ...]) -> tuple[float, ...]:
        """The rest position for a robot's joints; BadInput for a joint the robot does not have."""
        for joint in self.home:
            if joint not in joints:
                raise BadInput(f"cell {self.name} home", f"unknown joint {joint}; the robot has {', '.join(joints)}")
        return tuple(self.home.get(joint, 0.0) for joint in joints)


def read_cell(path: Path) -> Cell:
    """A cell from its YAML file; BadInput names the field, or the existing cells."""
    if not path.exists():
        known = ", ".join(sorted(other.stem for other in path.parent.glob("*.yaml"))) or "none"
        raise BadInput("cell", f"there is no cell {path.stem} in {path.parent}; there is: {known}")
    return read_yaml(path, Cell)
