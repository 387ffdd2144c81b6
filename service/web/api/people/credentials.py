"""The credentials of a request: a key in its header, or a session in its cookie.

A browser cannot set a header when it opens a WebSocket, but it can name subprotocols: `sweepid.live` and
`sweepid.key.KEY`. The service accepts the first one and never returns the second one.
"""

from dataclasses import dataclass

from starlette.datastructures import Headers
from starlette.requests import cookie_parser
from starlette.types import Scope

from service.store.access.credentials import bearer

LIVE = "sweepid.live"
_KEY = "sweepid.key."


@dataclass(frozen=True)
class Credentials:
    """`key`: empty without credentials. `cookie`: the browser sent it automatically, for a page of any origin."""

    key: str
    cookie: bool


def shown(scope: Scope) -> Credentials:
    """The header has priority over the cookie: a header is never sent automatically."""
    headers = Headers(scope=scope)
    if key := bearer(headers.get("authorization", "")) or _of_subprotocol(scope):
        return Credentials(key, cookie=False)
    return Credentials(cookie_parser(headers.get("cookie", "")).get(cookie_name(scope), ""), cookie=True)


def cookie_name(scope: Scope) -> str:
    """Depends on the port that the browser sees: all ports of a computer share their cookies; each cell has a port."""
    port = Headers(scope=scope).get("host", "").rpartition("]")[2].rpartition(":")[2]
    return f"sweepid-{port}" if port.isascii() and port.isdigit() else "sweepid"


def _of_subprotocol(scope: Scope) -> str:
    """The key from the subprotocols of a WebSocket, or empty."""
    named = (name.removeprefix(_KEY) for name in scope.get("subprotocols", ()) if name.startswith(_KEY))
    return next(named, "")
