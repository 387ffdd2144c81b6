"""The audit as a chain: the SHA-256 of an entry covers the previous SHA-256 and its own canonical JSON. Pure.

A changed, removed or inserted entry breaks the chain at this position. Removed entries at the end are not detected by
the chain alone; a head (number and hash) that was stored elsewhere detects them.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping

from service.errors import BadInput, SweepidError
from service.people.keys import masked

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


def verify(links: Iterable[Link], expected: Head | None = None) -> Head:
    """The head of a valid chain, (0, FIRST) for an empty one. AuditBroken if an entry does not match.

    `expected`: a head that was stored elsewhere; the chain must contain it.
    """
    number, previous = 0, FIRST
    for number_here, entry, hash_here in links:
        if number_here != number + 1:
            raise AuditBroken(number + 1, f"is missing; {number_here} follows {number}")
        number = number_here
        if sha256(previous, entry) != hash_here:
            raise AuditBroken(number, "its hash does not match its content and the entry before it")
        if expected is not None and expected[0] == number and expected[1] != hash_here:
            raise AuditBroken(number, f"its hash is {hash_here}, not {expected[1]}")
        previous = hash_here
    if expected is not None and expected[0] > number:
        raise AuditBroken(number + 1, f"is missing; the audit continued to {expected[0]}")
    return number, previous


def read_head(text: str) -> Head:
    """Reads ``NUMBER:SHA256``, as the command `verify` prints it."""
    if re.fullmatch(r"[0-9]{1,10}:[0-9a-f]{64}", text) is None:
        raise BadInput("--head", f"{text!r} is not NUMBER:SHA256")
    number, _, value = text.partition(":")
    return int(number), value
