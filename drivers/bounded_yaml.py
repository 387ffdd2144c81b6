"""Reads files that anybody may have written, YAML above all, and those that describe a machine: profiles and maps."""

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol, cast

import yaml

from drivers.errors import BadProfile

# PyYAML raises these in addition to YAMLError for a value that does not fit its tag (`2001-13-45`, `!!bool x`)
NO_VALUE = (ValueError, LookupError, AttributeError)


class _Events(Protocol):
    """Part of PyYAML's loader that its type stubs do not declare."""

    def get_event(self) -> yaml.Event: ...


class BoundedLoader(yaml.SafeLoader):
    """PyYAML's safe loader with limits that are checked event by event, before any object is built.

    Raises YAMLError for nesting deeper than `DEEPEST`, an alias inside its own anchor, or aliases that expand to
    more than `MOST_CHARACTERS`. PyYAML itself would build these, and code that walks through the result might not
    end.
    """

    longest = 2**22  # with aliases written out; a file may have 2**20 bytes
    deepest = 32  # levels of nesting; the files of `config` have 6

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
            if len(self._open) > BoundedLoader.deepest:
                raise _refusal(f"nested too deeply, limit {BoundedLoader.deepest} levels", event)
        elif isinstance(event, yaml.CollectionEndEvent):
            self._closed(*self._open.pop(), 1)
        if self._size > BoundedLoader.longest:
            raise _refusal(f"aliases stand for more than {BoundedLoader.longest} characters", event)
        return event

    def _closed(self, anchor: str | None, before: int, own: int) -> None:
        self._size += own
        if anchor is not None:
            self._sizes[anchor] = self._size - before


def _refusal(problem: str, event: yaml.Event) -> yaml.YAMLError:
    return yaml.MarkedYAMLError(None, None, problem, event.start_mark)


LARGEST = 2**20  # bytes


def read_bounded(path: Path, largest: int = LARGEST) -> bytes:
    """The content of a file. Raises OSError, and ValueError if it has more than `largest` bytes."""
    with path.open("rb") as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        raise ValueError(f"is larger than {largest} bytes")
    return content


def parse_yaml(text: str | bytes, largest: int = LARGEST) -> object:
    """The content of a YAML text, in UTF-8. Raises ValueError with the reason if it is invalid."""
    if len(text) > largest:
        raise ValueError(f"YAML of {len(text)} characters, limit {largest}")
    try:
        return yaml.load(text if isinstance(text, str) else text.decode("utf-8"), Loader=BoundedLoader)
    except (yaml.YAMLError, *NO_VALUE) as error:
        raise ValueError(f"not YAML: {' '.join(str(error).split())}") from None


def read_mapping(path: Path, key: str) -> Mapping[str, object]:
    """The content of the file, which must have the key `key`. BadProfile has the reason but not the file name."""
    try:
        content = parse_yaml(read_bounded(path))
    except OSError as error:
        raise BadProfile(str(error.strerror)) from None
    except ValueError as error:
        raise BadProfile(str(error)) from None
    if not isinstance(content, Mapping):
        raise BadProfile(f"must be a mapping with the key '{key}'")
    return cast("Mapping[str, object]", content)
