"""Passwords of people: argon2id with the parameters that its library holds for right. Pure.

A hash takes some 0.1 s and 64 MiB: never on the event loop, and never many at once.
"""

import base64
import unicodedata

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from service.errors import BadInput

LEAST = 12  # characters; NIST SP 800-63B: a length, and no rule about what they are

_HASHER = PasswordHasher()


def password_hash(password: str) -> str:
    """What is stored: parameters, salt and hash. BadInput where it is too short."""
    if len(password) < LEAST:
        raise BadInput("password", f"has {len(password)} characters; use at least {LEAST}, for instance some words")
    return _HASHER.hash(_bytes(password))


def fits(password: str, stored: str | None) -> bool:
    """Whether it is the one that was stored. None: of nobody, which takes as long and never fits."""
    try:
        return _HASHER.verify(stored or _nobodys(), _bytes(password)) and stored is not None
    except (VerificationError, InvalidHashError):
        return False


def outdated(stored: str) -> bool:
    """Whether the library holds other parameters for right by now."""
    return _HASHER.check_needs_rehash(stored)


def _nobodys() -> str:
    """A hash of today's parameters that no password has, as far as anybody can find out: of zeros alone."""
    salt, zeros = (base64.b64encode(bytes(n)).decode().rstrip("=") for n in (_HASHER.salt_len, _HASHER.hash_len))
    cost = f"m={_HASHER.memory_cost},t={_HASHER.time_cost},p={_HASHER.parallelism}"
    return f"$argon2id$v=19${cost}${salt}${zeros}"


def _bytes(password: str) -> bytes:
    """The same ones from every keyboard; JSON may escape half a surrogate pair."""
    return unicodedata.normalize("NFKC", password).encode("utf-8", "surrogatepass")
