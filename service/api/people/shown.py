"""What a request shows of who it is: a key in its header, or a session in its cookie."""

from dataclasses import dataclass

from starlette.datastructures import Headers
from starlette.requests import cookie_parser
from starlette.types import Scope

from service.people.keys import bearer


@dataclass(frozen=True)
class Shown:
    """`key`: empty where it shows nothing; `cookie`: a browser sent it by itself, whoever's page it was that asked."""

    key: str
    cookie: bool


def shown(scope: Scope) -> Shown:
    """The header stands above the cookie: who sends one means it."""
    headers = Headers(scope=scope)
    if key := bearer(headers.get("authorization", "")):
        return Shown(key, cookie=False)
    return Shown(cookie_parser(headers.get("cookie", "")).get(cookie_name(scope), ""), cookie=True)


def cookie_name(scope: Scope) -> str:
    """By the port that the browser sees: cookies of one computer's ports are in one jar, and each cell has a port."""
    port = Headers(scope=scope).get("host", "").rpartition("]")[2].rpartition(":")[2]
    return f"sweepid-{port}" if port.isascii() and port.isdigit() else "sweepid"
