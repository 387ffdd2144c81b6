"""The audit as a chain: each entry's SHA-256 goes over that of the one before it and its own canonical JSON. Pure.

Who changes, removes or inserts an entry breaks the chain there. Who cuts off its end does not: a head (number and hash)
that was kept elsewhere tells.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping

from service.errors import BadInput, SweepidError
from service.people.keys import masked

FIRST = "0" * 64
"""Stands before the first entry."""

Fact = str | int | float | list[int] | list[str] | None
Entry = Mapping[str, Fact]  # flat: who, what, from where, and what came of it
Link = tuple[int, str, str]  # number, canonical JSON, SHA-256
Head = tuple[int, str]  # number and SHA-256 of the last link


class AuditBroken(SweepidError):
    """Somebody changed the audit; `number` is the first entry that does not fit."""

    def __init__(self, number: int, reason: str) -> None:
        super().__init__(f"audit entry {number}: {reason}")
        self.number = number


def canonical(entry: Entry) -> str:
    """JSON with sorted keys, without spaces, in ASCII; keys of people are not in it."""
    return masked(json.dumps(dict(entry), sort_keys=True, separators=(",", ":"), allow_nan=False))


def sha256(previous: str, entry: str) -> str:
    """Of the entry (canonical JSON) after the one with hash `previous`."""
    return hashlib.sha256(f"{previous}\n{entry}".encode()).hexdigest()


def verify(links: Iterable[Link], expected: Head | None = None) -> Head:
    """The head of a chain that holds, (0, FIRST) of an empty one. AuditBroken.

    `expected`: a head that was kept elsewhere; the chain must go through it.
    """
    number, previous = 0, FIRST
    for number_here, entry, hash_here in links:
        if number_here != number + 1:
            raise AuditBroken(number + 1, f"is missing; {number_here} follows {number}")
        number = number_here
        if sha256(previous, entry) != hash_here:
            raise AuditBroken(number, "its hash is not that of its content after the entry before it")
        if expected is not None and expected[0] == number and expected[1] != hash_here:
            raise AuditBroken(number, f"its hash is {hash_here}, not {expected[1]}")
        previous = hash_here
    if expected is not None and expected[0] > number:
        raise AuditBroken(number + 1, f"is missing; the audit went on to {expected[0]}")
    return number, previous


def read_head(text: str) -> Head:
    """Of ``NUMBER:SHA256``, as `verify` of the command prints it."""
    if re.fullmatch(r"[0-9]{1,10}:[0-9a-f]{64}", text) is None:
        raise BadInput("--head", f"{text!r} is not NUMBER:SHA256")
    number, _, value = text.partition(":")
    return int(number), value
