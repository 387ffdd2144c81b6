"""The audit as a chain: the SHA-256 of an entry covers the previous SHA-256 and its own canonical JSON. Pure.

A changed, removed or inserted entry breaks the chain at this position. Removed entries at the end, and a chain that was
made anew, are not detected by the chain alone; heads (number and hash) that were stored elsewhere detect them.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence

from service.model.errors import BadInput, SweepidError
from service.store.access.credentials import masked

FIRST = "0" * 64
"""The hash before the first entry."""

Fact = str | int | float | list[int] | list[str] | None
Entry = Mapping[str, Fact]  # flat: caller, action, address and outcome
Link = tuple[int, str, str]  # number, canonical JSON, SHA-256
Head = tuple[int, str]  # number and SHA-256 of the last link


class AuditBroken(SweepidError):
    """The audit was changed; `number` is the first entry that does not match."""

    def __init__(self, number: int, reason: str) -> None:
        super().__init__(f"audit entry {number}: {reason}")
        self.number = number


def canonical(entry: Entry) -> str:
    """JSON with sorted keys, without spaces, in ASCII. The API keys of people are not in it."""
    return masked(json.dumps(dict(entry), sort_keys=True, separators=(",", ":"), allow_nan=False))


def sha256(previous: str, entry: str) -> str:
    """Hash of the entry (canonical JSON) that follows the entry with hash `previous`."""
    return hashlib.sha256(f"{previous}\n{entry}".encode()).hexdigest()


def verify(links: Iterable[Link], expected: Sequence[Head] = ()) -> Head:
    """The head of a valid chain, (0, FIRST) for an empty one. AuditBroken if an entry does not match.

    `expected`: heads that were stored elsewhere; the chain must contain each.
    """
    number, previous = 0, FIRST
    wanted: dict[int, set[str]] = {}
    for at, value in expected:
        wanted.setdefault(at, set()).add(value)
    for number_here, entry, hash_here in links:
        if number_here != number + 1:
            raise AuditBroken(number + 1, f"is missing; {number_here} follows {number}")
        number = number_here
        if sha256(previous, entry) != hash_here:
            raise AuditBroken(number, "its hash does not match its content and the entry before it")
        if other := wanted.get(number, set()) - {hash_here}:
            raise AuditBroken(number, f"its hash is {hash_here}, not {min(other)}")
        previous = hash_here
    if wanted and max(wanted) > number:
        raise AuditBroken(number + 1, f"is missing; the audit continued to {max(wanted)}")
    return number, previous


_HEAD = re.compile(r"(?<![0-9a-f:])([0-9]{1,10}):([0-9a-f]{64})(?![0-9a-f])", re.ASCII)


def read_head(text: str) -> Head:
    """Reads ``NUMBER:SHA256``, as the command `verify` prints it."""
    found = _HEAD.fullmatch(text)
    if found is None:
        raise BadInput("--head", f"{text!r} is neither NUMBER:SHA256 nor a file with such heads")
    return int(found[1]), found[2]


def heads_in(text: str, place: str) -> tuple[Head, ...]:
    """All heads in a text, for example in a file of heads or a log. BadInput if there is none."""
    heads = tuple((int(one[1]), one[2]) for one in _HEAD.finditer(text))
    if not heads:
        raise BadInput(place, "contains no NUMBER:SHA256")
    return heads
