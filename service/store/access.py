"""Roles, and scopes of keys: sets of routes. A route carries its least role (`service.web.api.route_roles`). Pure.

API keys, names of people and keys, callers. A key is 32 random bytes; only its SHA-256 is stored.
"""

import hashlib
import re
import secrets
from datetime import datetime
from enum import IntEnum
from typing import Annotated, Protocol

from pydantic import AfterValidator, StringConstraints


class Role(IntEnum):
    """Each role includes the rights of the roles before it."""

    VIEWER = 1
    OPERATOR = 2
    ENGINEER = 3
    ADMIN = 4

    @property
    def word(self) -> str:
        return self.name.lower()


MEANING = {
    Role.VIEWER: "reads everything but the audit",
    Role.OPERATOR: "runs plans that are stored, connects drives, acknowledges faults, releases stops",
    Role.ENGINEER: "stores robots, plans and bundles, approves plans, begins diagnoses and experiments, accepts models",
    Role.ADMIN: "reads the audit",
}
LOCAL = "local"
"""Name of the caller in a service without login, with all rights."""
SCOPES = {
    "read": "everything but metrics and the audit",
    "metrics": "GET /metrics",
    "measure": "makes, starts, pauses, resumes and aborts campaigns",
    "machine": "connects drives, acknowledges faults, releases stops",
    "store": "stores robots, plans and bundles",
    "diagnose": "diagnoses, their experiments and models; jobs",
    "audit": "the audit",
}
"""The scopes of a key, within its role."""


def new_key() -> str:
    """A new key as text. It is displayed once only."""
    return f"sweepid-{secrets.token_hex(32)}"


def key_sha256(key: str) -> str | None:
    """The stored hash of a key; None for an invalid key. No salt: a list of 256 random bits is impossible."""
    found = re.fullmatch(r"sweepid-([0-9a-f]{64})", key)
    return None if found is None else hashlib.sha256(bytes.fromhex(found[1])).hexdigest()


def bearer(authorization: str) -> str:
    """The key of an `Authorization` header; empty without a key."""
    scheme, _, key = authorization.strip().partition(" ")
    return key.strip() if scheme.lower() == "bearer" else ""


def masked(text: str) -> str:
    """The text without keys in wrong places, for example in a path or as a person's name."""
    # also of a key that was cut off; 15 digits or fewer reveal nothing
    return re.sub(r"sweepid-[0-9a-f]{16,}", "sweepid-(key)", text)


LONGEST_NAME = 100  # characters

PersonName = Annotated[
    str, StringConstraints(strip_whitespace=True, min_length=1, max_length=LONGEST_NAME), AfterValidator(masked)
]
"""The name that a caller enters, without login. It is displayed and stored: a key in its place is masked."""


def is_name(name: str) -> bool:
    """Whether the name is printable, not too long, and has no other meaning in the audit."""
    return (
        name not in ("local", "anybody", "unknown")
        and name.isprintable()
        and name == name.strip()
        and 1 <= len(name) <= LONGEST_NAME
    )


def unique_name(name: str, subject: str) -> str:
    """A name for a user without a usable name: always the same one, from the id at the provider."""
    short = hashlib.sha256(subject.encode()).hexdigest()[:12]
    return f"{name[: LONGEST_NAME - 20]} ({short})"


class Caller(Protocol):
    """An authenticated caller."""

    @property
    def name(self) -> str: ...

    @property
    def role(self) -> Role: ...

    @property
    def scopes(self) -> tuple[str, ...] | None:
        """The scopes of the caller, within his role; None: no limit but the role."""
        ...

    def trouble(self, at: datetime) -> str:
        """Why the caller is not accepted at that time; empty if accepted."""
        ...


class Callers(Protocol):
    """A store of callers."""

    def now(self) -> datetime:
        """The time by which these callers expire; it never runs backward."""
        ...

    def find(self, key: str) -> Caller | None:
        """Blocks. `key`: as sent by the caller; also finds callers that are no longer accepted."""
        ...
