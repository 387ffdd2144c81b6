"""Passwords of people: argon2id with the parameters that its library recommends. Pure.

A hash takes about 0.1 s and 64 MiB: never compute it on the event loop, and never many at the same time.
"""

import base64
import unicodedata

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from service.model.errors import BadInput

LEAST = 12  # characters; NIST SP 800-63B: a minimum length and no rules on the characters

_HASHER = PasswordHasher()


def password_hash(password: str) -> str:
    """The stored text: parameters, salt and hash. BadInput if the password is too short."""
    if len(password) < LEAST:
        raise BadInput("password", f"has {len(password)} characters; use at least {LEAST}, for instance some words")
    return _HASHER.hash(_bytes(password))


def fits(password: str, stored: str | None) -> bool:
    """Whether it is the stored password. None: of an unknown user; takes the same time and never matches."""
    try:
        return _HASHER.verify(stored or _nobodys(), _bytes(password)) and stored is not None
    except (VerificationError, InvalidHashError):
        return False


def outdated(stored: str) -> bool:
    """Whether the library now recommends other parameters."""
    return _HASHER.check_needs_rehash(stored)


def _nobodys() -> str:
    """A hash of zeros with the present parameters; no known password has it."""
    salt, zeros = (base64.b64encode(bytes(n)).decode().rstrip("=") for n in (_HASHER.salt_len, _HASHER.hash_len))
    cost = f"m={_HASHER.memory_cost},t={_HASHER.time_cost},p={_HASHER.parallelism}"
    return f"$argon2id$v=19${cost}${salt}${zeros}"


def _bytes(password: str) -> bytes:
    """The same bytes from every keyboard; JSON may escape half a surrogate pair."""
    return unicodedata.normalize("NFKC", password).encode("utf-8", "surrogatepass")
