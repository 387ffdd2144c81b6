"""The first thing a request meets: whom it was meant for, where it came from, how large it is.

A web page that an operator has open in the same browser must not be able to move a machine: a request that a
page of another origin sends is refused, and so is one for a host name that is not ours (DNS rebinding).
Stopping is never refused. Who it is that asks is the next question: `service.api.people.access`.
"""

from collections.abc import Mapping, Sequence
from http import HTTPStatus
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.problem import problem_response

BODY_LIMIT = 256 * 2**10  # bytes of JSON
ROBOT_LIMIT = 4 * 2**20  # with a URDF in it
BUNDLE_LIMIT = 512 * 2**20


class Gate:
    """ASGI middleware. `hosts`: host names that the service answers to; empty: any."""

    def __init__(
        self, app: ASGIApp, hosts: Sequence[str], stop_path: str, limits: Mapping[str, int], origins: Sequence[str] = ()
    ) -> None:
        """`origins`: whose pages may send requests, beside its own.

        `limits`: bytes of a body by path, where it may be larger than `BODY_LIMIT`.
        """
        self._app = app
        self._hosts = frozenset(hosts)
        self._stop_path = stop_path
        self._limits = dict(limits)
        self._origins = frozenset(origins)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        if scope["path"].rstrip("/") == self._stop_path:  # a slash too many would be redirected: it is a stop
            await self._app({**scope, "path": self._stop_path}, receive, send)
            return
        headers = Headers(scope=scope)
        refusal = self._stranger(headers)
        if refusal:
            await self._refuse(scope, receive, send, HTTPStatus.FORBIDDEN, "foreign-request", refusal)
            return
        limit = self._limits.get(scope["path"], BODY_LIMIT)
        length = headers.get("content-length", "0")
        if length.isdigit() and int(length) > limit:
            detail = f"body of {length} bytes, limit {limit} bytes"
            await self._refuse(scope, receive, send, HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "body-too-large", detail)
            return
        await self._app(scope, _limited(receive, limit), send)

    def _stranger(self, headers: Headers) -> str:
        host = headers.get("host", "")
        if self._hosts and _parts(f"//{host}")[0] not in self._hosts:
            return f"host {host!r} is not this service; it answers to {', '.join(sorted(self._hosts))}"
        origin = headers.get("origin")
        if origin is not None and origin.lower() not in self._origins and not from_own_page(headers):
            return f"sent by a page of {origin}, not of {host}"
        return ""

    async def _refuse(
        self, scope: Scope, receive: Receive, send: Send, status: HTTPStatus, name: str, detail: str
    ) -> None:
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": detail[:120]})
            return
        await problem_response(Request(scope), status, name, detail)(scope, receive, send)


def from_own_page(headers: Headers) -> bool:
    """Whether a browser says that a page of this very service sends it; False where nobody says so."""
    return _parts(headers.get("origin", ""))[1] == headers.get("host", "") != ""


def _parts(address: str) -> tuple[str | None, str]:
    """Host name without port, and network location; of what is no address, none."""
    try:
        parts = urlsplit(address)
        return parts.hostname, parts.netloc
    except ValueError:  # a bracket that nothing closes
        return None, ""


def _limited(receive: Receive, limit: int) -> Receive:
    """A body without a declared length is counted while it comes."""
    total = 0

    async def counted() -> Message:
        nonlocal total
        message = await receive()
        total += len(message.get("body", b""))
        if total > limit:
            raise HTTPException(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"body of more than {limit} bytes")
        return message

    return counted
