"""Reads the YAML files of ``config/`` into frozen pydantic models; BadInput names the invalid field."""

from collections.abc import Iterator
from difflib import get_close_matches
from pathlib import Path
from typing import Protocol, TypeVar, cast, get_args

import yaml
from pydantic import BaseModel, ValidationError

from service.model.errors import BadInput
from service.model.robot import Robot, RobotDescription, robot_from_outside

Model = TypeVar("Model", bound=BaseModel)

LARGEST_YAML = 2**20  # bytes
LARGEST_TEXT = 2**26  # bytes
_MOST_TOLD = 12  # files
# exceptions of PyYAML for a value that does not match its tag (`2001-13-45`, `!!bool x`, 5000 digits), except YAMLError
_NO_VALUE = (ValueError, LookupError, AttributeError)
DEEPEST = 32  # levels of nesting; the files of `config` have 6
MOST_CHARACTERS = 2**22  # with aliases expanded; a file may have 2**20 bytes


class _Events(Protocol):
    """Types for the part of PyYAML that its stubs leave untyped."""

    def get_event(self) -> yaml.Event: ...


class BoundedLoader(yaml.SafeLoader):
    """PyYAML's safe loader, with limits that are checked at each event, before an object is built.

    YAMLError: nested deeper than `DEEPEST`, an alias inside its own anchor, or aliases that expand to a text of more
    than `MOST_CHARACTERS`. PyYAML itself accepts all of them, and processing of the result may then never end.
    """

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._open: list[tuple[str | None, int]] = []  # anchor of each open collection, and the size before it
        self._sizes: dict[str, int] = {}  # by anchor
        self._size = 0  # characters, and one for each value

    def get_event(self) -> yaml.Event:
        event = cast("_Events", super()).get_event()
        if isinstance(event, yaml.AliasEvent):
            if any(anchor == event.anchor for anchor, _ in self._open):
                raise _refusal(f"alias *{event.anchor} is inside of its own anchor", event)
            self._size += self._sizes.get(event.anchor, 0)
        elif isinstance(event, yaml.ScalarEvent):
            self._closed(event.anchor, self._size, 1 + len(event.value))
        elif isinstance(event, yaml.CollectionStartEvent):
            self._open.append((event.anchor, self._size))
            if len(self._open) > DEEPEST:
                raise _refusal(f"nested too deeply, limit {DEEPEST} levels", event)
        elif isinstance(event, yaml.CollectionEndEvent):
            self._closed(*self._open.pop(), 1)
        if self._size > MOST_CHARACTERS:
            raise _refusal(f"aliases stand for more than {MOST_CHARACTERS} characters", event)
        return event

    def _closed(self, anchor: str | None, before: int, own: int) -> None:
        self._size += own
        if anchor is not None:
            self._sizes[anchor] = self._size - before


def _refusal(problem: str, event: yaml.Event) -> yaml.YAMLError:
    return yaml.MarkedYAMLError(None, None, problem, event.start_mark)


def read_yaml(path: Path, kind: type[Model]) -> Model:
    """The file as a `kind`; BadInput names file, field and value."""
    try:
        content: object = yaml.load(read_text(path, LARGEST_YAML), Loader=BoundedLoader)
    except yaml.YAMLError as error:
        raise BadInput(str(path), f"not YAML: {' '.join(str(error).split())}") from None
    except _NO_VALUE as error:
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
    try:
        there = sorted(one.name for one in path.parent.iterdir() if one.suffix == path.suffix)
    except OSError:
        return ""
    return f"; {path.parent} has {', '.join(there[:_MOST_TOLD])}" if there else ""
