"""API keys: 32 random bytes that a person or a program shows. Only their SHA-256 is stored."""

import hashlib
import re
import secrets

BYTES = 32
_FORM = re.compile(rf"sweepid-([0-9a-f]{{{2 * BYTES}}})", re.ASCII)


def new_key() -> str:
    """As it is shown once."""
    return f"sweepid-{secrets.token_hex(BYTES)}"


def key_sha256(key: str) -> str | None:
    """What is stored of a key; None of what is none. No salt: 256 random bits cannot be guessed from a list."""
    found = _FORM.fullmatch(key)
    return None if found is None else hashlib.sha256(bytes.fromhex(found[1])).hexdigest()


def bearer(authorization: str) -> str:
    """The key of an `Authorization` header, empty where it has none."""
    scheme, _, key = authorization.strip().partition(" ")
    return key.strip() if scheme.lower() == "bearer" else ""


def masked(text: str) -> str:
    """Without the keys that somebody put where they do not belong, a path for instance."""
    return _FORM.sub("sweepid-(key)", text)
