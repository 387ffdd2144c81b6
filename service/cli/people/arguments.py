"""Names, roles, scopes and passwords as a person typed them."""

import getpass
import sys

from service.model.errors import BadInput
from service.store.access.credentials import LONGEST_NAME, is_name
from service.store.access.permissions import SCOPES, Role

ROLES = {role.word: role for role in Role}


def name_of(given: str) -> str:
    """A name that may be given. BadInput."""
    name = given.strip()
    if not is_name(name):
        raise BadInput("NAME", f"{name[:LONGEST_NAME]!r} is not a name: 1 to {LONGEST_NAME} printable characters")
    return name


def role_of(word: str) -> Role:
    """BadInput."""
    if word not in ROLES:
        raise BadInput("--role", f"{word!r} is not one of {', '.join(ROLES)}")
    return ROLES[word]


def scopes_of(words: list[str]) -> tuple[str, ...] | None:
    """None where there are none: all that the role may. BadInput."""
    for word in words:
        if word not in SCOPES:
            raise BadInput("--scope", f"{word!r} is not one of {', '.join(SCOPES)}")
    return tuple(dict.fromkeys(words)) or None


def password_for(name: str) -> str:
    """Asked for twice at a terminal, else the first line of stdin: no argument, which every process can read."""
    if not sys.stdin.isatty():
        return sys.stdin.readline().removesuffix("\n")
    password = getpass.getpass(f"Password of {name}: ")
    if getpass.getpass("Once more: ") != password:
        raise BadInput("password", "the two passwords differ; nothing was changed")
    return password
