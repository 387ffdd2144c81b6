"""Valid names of people and keys. Pure."""

import hashlib
from typing import Annotated

from pydantic import AfterValidator, StringConstraints

from service.store.access.keys import masked

TAKEN = ("local", "anybody", "unknown")  # these have another meaning in the audit
LONGEST_NAME = 100  # characters

PersonName = Annotated[
    str, StringConstraints(strip_whitespace=True, min_length=1, max_length=LONGEST_NAME), AfterValidator(masked)
]
"""The name that a caller enters, without login. It is displayed and stored: a key in its place is masked."""


def is_name(name: str) -> bool:
    """Whether the name is printable, not too long, and not reserved."""
    return name not in TAKEN and name.isprintable() and name == name.strip() and 1 <= len(name) <= LONGEST_NAME


def unique_name(name: str, subject: str) -> str:
    """A name for a user without a usable name: always the same one, from the id at the provider."""
    short = hashlib.sha256(subject.encode()).hexdigest()[:12]
    return f"{name[: LONGEST_NAME - 20]} ({short})"
