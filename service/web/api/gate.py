"""The first check of each request: its host, its origin and its size.

A web page that is open in the same browser must not be able to move a machine. So a request from a page of another
origin is refused, and also a request for a foreign host name (DNS rebinding).
Stopping is never refused. Authentication is the next check: `service.web.api.access`.
"""

import re
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from structlog.contextvars import bound_contextvars

from service.process.telemetry import TRACING
from service.web.api.problem import RequestRefused

ROBOT_LIMIT = 4 * 2**20  # with a URDF in it
BUNDLE_LIMIT = 512 * 2**20


class Gate:
    """ASGI middleware. `hosts`: host names that the service accepts; empty: all."""

    body_limit = 256 * 2**10  # bytes of JSON

    def __init__(
        self, app: ASGIApp, hosts: Sequence[str], stop_path: str, limits: Mapping[str, int], origins: Sequence[str] = ()
    ) -> None:
        """`origins`: origins whose pages may send requests, in addition to the service's own.

        `limits`: maximum bytes of a body by path, for paths that allow more than `BODY_LIMIT`.
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
        if scope["path"].rstrip("/") == self._stop_path:  # an additional slash would cause a redirect: it is a stop
            await self._app({**scope, "path": self._stop_path}, receive, send)
            return
        headers = Headers(scope=scope)
        refusal = self._stranger(headers)
        if refusal:
            await refuse(RequestRefused(HTTPStatus.FORBIDDEN, "foreign-request", refusal), scope, receive, send)
            return
        limit = self._limits.get(scope["path"], Gate.body_limit)
        length = headers.get("content-length", "0")
        if length.isdigit() and int(length) > limit:
            detail = f"body of {length} bytes, limit {limit} bytes"
            refused = RequestRefused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "body-too-large", detail)
            await refuse(refused, scope, receive, send)
            return
        await self._app(scope, _limited(receive, limit), send)

    def _stranger(self, headers: Headers) -> str:
        host = headers.get("host", "")
        if self._hosts and _parts(f"//{host}")[0] not in self._hosts:
            return (
                f"host {host!r} is not accepted by this service; accepted are "
                f"{', '.join(sorted(self._hosts))} (setting `allowed_hosts`)"
            )
        origin = headers.get("origin")
        if origin is not None and origin.lower() not in self._origins and not from_own_page(headers):
            return f"request from a page of {origin}; only pages of {host} are accepted"
        return ""


async def refuse(refused: RequestRefused, scope: Scope, receive: Receive, send: Send) -> None:
    """Answer a request, or close a WebSocket before it is accepted."""
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": refused.detail[:120]})
        return
    await refused.response(Request(scope))(scope, receive, send)


def from_own_page(headers: Headers) -> bool:
    """Whether the browser's headers say that a page of this service sent the request; False without such headers."""
    return _parts(headers.get("origin", ""))[1] == headers.get("host", "") != ""


def _parts(address: str) -> tuple[str | None, str]:
    """Host name without port, and network location; None and empty for an invalid address."""
    try:
        parts = urlsplit(address)
        return parts.hostname, parts.netloc
    except ValueError:  # a bracket is not closed
        return None, ""


def _limited(receive: Receive, limit: int) -> Receive:
    """Counts the bytes of a body without a declared length while it arrives."""
    total = 0

    async def counted() -> Message:
        nonlocal total
        message = await receive()
        total += len(message.get("body", b""))
        if total > limit:
            raise HTTPException(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"body of more than {limit} bytes")
        return message

    return counted


class Logged:
    """ASGI middleware."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        of_campaign = re.compile(r"/campaigns/(?P<campaign>[0-9]{1,10})(?:/sweeps/(?P<sweep>[0-9]{1,10}))?(?:/|$)")
        found = of_campaign.search(scope["path"]) if scope["type"] in ("http", "websocket") else None
        about = {} if found is None else {name: int(number) for name, number in found.groupdict().items() if number}
        with bound_contextvars(**about):
            # no spans of reads: they are many, and no estimate results from them
            if scope["type"] == "http" and scope["method"] in ("POST", "PUT", "PATCH", "DELETE"):
                await self._traced(scope, receive, send)
            else:
                await self._app(scope, receive, send)

    async def _traced(self, scope: Scope, receive: Receive, send: Send) -> None:
        """A client with its own trace (header `traceparent`) finds the request in that trace."""
        path = str(scope["path"])[:200]
        parent = next((value.decode("latin-1") for name, value in scope["headers"] if name == b"traceparent"), "")
        with TRACING.span(f"{scope['method']} {re.sub('/[0-9]+(?=/|$)', '/{id}', path)}", parent) as note:
            note("http.request.method", scope["method"])
            note("url.path", path)

            async def noted(message: Message) -> None:
                if message["type"] == "http.response.start":
                    note("http.response.status_code", message["status"])
                await send(message)

            await self._app(scope, receive, noted)
