"""Which tests are of the second tier, `make test-long`, and in which of its parts.

There a property is repeated on further buses, drives, makers, seeds, cells or processes, or with records of full size;
the first tier, `make test`, has each once. What docs/explanation/safety.md names is of the first.
"""

from functools import cache
from typing import NamedTuple

PARTS = 10  # each `.ci/run` runs one of them

LONG: dict[str, float] = {  # file[::function][[first parameters]: processor time in s, on an idle computer
}


class Name(NamedTuple):
    """What a test is called by: its file, its function, the beginning of its parameters."""

    file: str
    function: str
    parameters: str


def name_of(nodeid: str) -> Name:
    """Of a test, or of a line of `LONG`, where function and parameters may be missing."""
    called, _, parameters = nodeid.partition("[")
    file, _, function = called.partition("::")
    return Name(file, function.rpartition("::")[2], parameters.removesuffix("]"))


def entry_of(nodeid: str) -> str | None:
    """Which line of `LONG` a test falls under: the first that names it."""
    test = name_of(nodeid)
    for entry in _of_file().get(test.file, ()):
        wanted = name_of(entry)
        if wanted.function in ("", test.function) and test.parameters.startswith(wanted.parameters):
            return entry
    return None


def part_of(nodeid: str) -> int | None:
    """Its part of the second tier; None for the first."""
    entry = entry_of(nodeid)
    return None if entry is None else parts()[entry]


@cache
def _of_file() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for entry in LONG:
        found.setdefault(name_of(entry).file, []).append(entry)
    return found


@cache
def parts() -> dict[str, int]:
    """The part of each line of `LONG`: the most costly first, each to the part that has the least so far."""
    costs = dict.fromkeys(range(1, PARTS + 1), 0.0)
    found: dict[str, int] = {}
    for entry in sorted(LONG, key=lambda entry: (-LONG[entry], entry)):
        found[entry] = part = min(costs, key=lambda part: (costs[part], part))
        costs[part] += LONG[entry]
    return found
