"""Valid names of people and keys. Pure."""

import hashlib

TAKEN = ("local", "anybody", "unknown")  # these have another meaning in the audit
LONGEST_NAME = 100  # characters


def is_name(name: str) -> bool:
    """Whether the name is printable, not too long, and not reserved."""
    return name not in TAKEN and name.isprintable() and name == name.strip() and 1 <= len(name) <= LONGEST_NAME


def unique_name(name: str, subject: str) -> str:
    """A name for a user without a usable name: always the same one, from the id at the provider."""
    short = hashlib.sha256(subject.encode()).hexdigest()[:12]
    return f"{name[: LONGEST_NAME - 20]} ({short})"
