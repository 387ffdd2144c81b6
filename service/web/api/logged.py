"""Adds campaign and sweep of the request's path to its log lines; each changing request is a span of a trace."""

import re

from starlette.types import ASGIApp, Message, Receive, Scope, Send
from structlog.contextvars import bound_contextvars

from service.process.telemetry import TRACING

_PATH = re.compile(r"/campaigns/(?P<campaign>[0-9]{1,10})(?:/sweeps/(?P<sweep>[0-9]{1,10}))?(?:/|$)")
_NUMBER = re.compile(r"/[0-9]+(?=/|$)")
_CHANGES = ("POST", "PUT", "PATCH", "DELETE")  # no spans of reads: they are many, and no estimate results from them
_LONGEST = 200  # maximum characters of a path in a trace


class Logged:
    """ASGI middleware."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        found = _PATH.search(scope["path"]) if scope["type"] in ("http", "websocket") else None
        about = {} if found is None else {name: int(number) for name, number in found.groupdict().items() if number}
        with bound_contextvars(**about):
            if scope["type"] == "http" and scope["method"] in _CHANGES:
                await self._traced(scope, receive, send)
            else:
                await self._app(scope, receive, send)

    async def _traced(self, scope: Scope, receive: Receive, send: Send) -> None:
        """A client with its own trace (header `traceparent`) finds the request in that trace."""
        path = str(scope["path"])[:_LONGEST]
        parent = next((value.decode("latin-1") for name, value in scope["headers"] if name == b"traceparent"), "")
        with TRACING.span(f"{scope['method']} {_NUMBER.sub('/{id}', path)}", parent) as span:
            span.note("http.request.method", scope["method"])
            span.note("url.path", path)

            async def noted(message: Message) -> None:
                if message["type"] == "http.response.start":
                    span.note("http.response.status_code", message["status"])
                await send(message)

            await self._app(scope, receive, noted)
