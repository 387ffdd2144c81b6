"""API keys: 32 random bytes, which a person or a program sends. Only their SHA-256 is stored."""

import hashlib
import re
import secrets

BYTES = 32
_FORM = re.compile(rf"sweepid-([0-9a-f]{{{2 * BYTES}}})", re.ASCII)
_PART = re.compile(
    r"sweepid-[0-9a-f]{16,}", re.ASCII
)  # also of a key that was cut off; 15 digits or fewer reveal nothing


def new_key() -> str:
    """A new key as text. It is displayed once only."""
    return f"sweepid-{secrets.token_hex(BYTES)}"


def key_sha256(key: str) -> str | None:
    """The stored hash of a key; None for an invalid key. No salt: a list of 256 random bits is impossible."""
    found = _FORM.fullmatch(key)
    return None if found is None else hashlib.sha256(bytes.fromhex(found[1])).hexdigest()


def bearer(authorization: str) -> str:
    """The key of an `Authorization` header; empty without a key."""
    scheme, _, key = authorization.strip().partition(" ")
    return key.strip() if scheme.lower() == "bearer" else ""


def masked(text: str) -> str:
    """The text without keys in wrong places, for example in a path or as a person's name."""
    return _PART.sub("sweepid-(key)", text)
