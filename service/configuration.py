"""Reads the YAML files of ``config/`` into frozen pydantic models; one BadInput names what does not fit."""

from collections.abc import Iterator
from difflib import get_close_matches
from pathlib import Path
from typing import Protocol, TypeVar, cast, get_args

import yaml
from pydantic import BaseModel, ValidationError

from service.errors import BadInput
from service.robot import Robot, RobotDescription, build_robot

Model = TypeVar("Model", bound=BaseModel)

LARGEST_YAML = 2**20  # bytes
LARGEST_TEXT = 2**26  # bytes
_MOST_TOLD = 12  # files
# PyYAML's own for a value that is not of its tag (`2001-13-45`, `!!bool x`, 5000 digits), beside YAMLError
_NO_VALUE = (ValueError, LookupError, AttributeError)
MOST_ALIASES = 20  # aliases of aliases grow with a power of their number


class _Events(Protocol):
    """What PyYAML's stubs leave without a type."""

    def get_event(self) -> yaml.Event: ...


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader, for files that somebody else may have written."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._aliases = 0

    def get_event(self) -> yaml.Event:
        event = cast("_Events", super()).get_event()
        self._aliases += isinstance(event, yaml.AliasEvent)
        if self._aliases > MOST_ALIASES:
            raise yaml.YAMLError(f"more than {MOST_ALIASES} aliases")
        return event


def read_yaml(path: Path, kind: type[Model]) -> Model:
    """The file as a `kind`; BadInput names file, field and value."""
    try:
        content: object = yaml.load(read_text(path, LARGEST_YAML), Loader=_Loader)
    except yaml.YAMLError as error:
        raise BadInput(str(path), f"not YAML: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise BadInput(str(path), "not YAML of any use: nested too deeply") from None
    except _NO_VALUE as error:
        raise BadInput(str(path), f"not YAML: a value is not of its type: {error}") from None
    if isinstance(content, dict):
        for key in cast("dict[object, object]", content):
            if not isinstance(key, str):  # settings take keys as keywords
                raise BadInput(str(path), f"key {key!r} is not text")
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        raise bad_field(str(path), error, kind) from None


def read_robot(path: Path) -> Robot:
    """A robot from its side file (``config/robots/*.yaml``) and the URDF that the file names, relative to itself."""
    description = read_yaml(path, RobotDescription)
    urdf = path.parent / description.urdf
    return build_robot(description, read_text(urdf), str(path))


def read_text(path: Path, largest: int = LARGEST_TEXT) -> str:
    """The UTF-8 text of a file that a person named; BadInput if it cannot be read or has more than `largest` bytes."""
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
    """The first complaint of pydantic, with the path to the field and what stood there.

    `kind`: the model that the content did not fit; then a key that it does not know is told with the one meant.
    """
    errors = error.errors(include_url=False)
    unknown = (one for one in errors if one["type"] == "extra_forbidden")  # tells more than the key that is missing
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
    """Of a model and of all models inside of it."""
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
    """The files that could have been meant: those of its folder with the same ending."""
    try:
        there = sorted(one.name for one in path.parent.iterdir() if one.suffix == path.suffix)
    except OSError:
        return ""
    return f"; {path.parent} has {', '.join(there[:_MOST_TOLD])}" if there else ""
