"""Reads the YAML files of ``config/`` into frozen pydantic models; one BadInput names what does not fit."""

from pathlib import Path
from typing import TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from service.errors import BadInput
from service.robot import Robot, RobotDescription, build_robot

Model = TypeVar("Model", bound=BaseModel)


def read_yaml(path: Path, kind: type[Model]) -> Model:
    """The file as a `kind`; BadInput names file, field and value."""
    try:
        content: object = yaml.safe_load(read_text(path))
    except yaml.YAMLError as error:
        raise BadInput(str(path), f"not YAML: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise BadInput(str(path), "not YAML of any use: nested too deeply") from None
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        raise bad_field(str(path), error) from None


def read_robot(path: Path) -> Robot:
    """A robot from its side file (``config/robots/*.yaml``) and the URDF that the file names, relative to itself."""
    description = read_yaml(path, RobotDescription)
    urdf = path.parent / description.urdf
    return build_robot(description, read_text(urdf), str(path))


def read_text(path: Path) -> str:
    """The UTF-8 text of a file that a person named; BadInput if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise BadInput(str(path), f"cannot be read: {error.strerror or error}") from None
    except ValueError as error:  # a NUL in the name, or bytes that are not UTF-8
        raise BadInput(str(path), f"cannot be read: {error}") from None


def bad_field(place: str, error: ValidationError) -> BadInput:
    """The first complaint of pydantic, with the path to the field and what stood there."""
    first = error.errors(include_url=False)[0]
    field = ".".join(str(part) for part in first["loc"])
    given = repr(first["input"])
    shown = "" if len(given) > 60 or first["type"] == "missing" else f", got {given}"
    return BadInput(f"{place} {field}".strip(), f"{first['msg']}{shown}")
