"""Reads text and YAML files that describe a virtual machine."""

from pathlib import Path
from typing import Protocol, cast

import yaml

LARGEST = 2**26  # bytes
# PyYAML raises these in addition to YAMLError for a value that does not fit its tag (`2001-13-45`, `!!bool x`)
_NO_VALUE = (ValueError, LookupError, AttributeError)
LARGEST_YAML = 2**20  # bytes
DEEPEST = 32  # levels of nesting; the files of `config` have 6
MOST_CHARACTERS = 2**22  # with aliases written out; a file may have 2**20 bytes


class _Events(Protocol):
    """Part of PyYAML's loader that its type stubs do not declare."""

    def get_event(self) -> yaml.Event: ...


class BoundedLoader(yaml.SafeLoader):
    """PyYAML's safe loader with limits that are checked event by event, before any object is built.

    Raises YAMLError for nesting deeper than `DEEPEST`, an alias inside its own anchor, or aliases that expand to
    more than `MOST_CHARACTERS`. PyYAML itself would build these, and code that walks through the result might not
    end.
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


def read_text(path: Path) -> str:
    """The UTF-8 text of a file. Raises OSError, and ValueError if it is not UTF-8 or too large."""
    with path.open("rb") as file:
        content = file.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise ValueError(f"is larger than {LARGEST} bytes")
    return content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")


def parse_yaml(text: str) -> object:
    """The content of a YAML text. Raises ValueError with the reason if it is invalid."""
    if len(text) > LARGEST_YAML:
        raise ValueError(f"YAML of {len(text)} characters, limit {LARGEST_YAML}")
    try:
        return yaml.load(text, Loader=BoundedLoader)
    except (yaml.YAMLError, *_NO_VALUE) as error:
        raise ValueError(f"not YAML: {' '.join(str(error).split())}") from None
