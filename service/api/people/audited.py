"""The outermost layer: what came of each change, and of all that was refused for who it was, goes to the audit.

A stop waits for no entry; everything else is answered when its outcome is on disk, or when that is known to be
impossible (then the log has it, and the entry `request` of a change is there without an outcome). What was refused
because its beginning could not be written is answered at once.
"""

import json
from contextlib import suppress
from http import HTTPStatus
from typing import Any, cast

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.people.trail import Trail, begin_trail, put, written
from service.people.permissions import Permissions
from service.store.people.writer import NotAudited

_REFUSED = (HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN, HTTPStatus.TOO_MANY_REQUESTS)


class Audited:
    """ASGI middleware."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._permissions = Permissions()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        trail = begin_trail(scope)
        trail.route = self._permissions.entry(trail.method, trail.path)
        answer = _Answer(scope, trail, send)
        try:
            await self._app(scope, receive, answer.send)
        except BaseException as error:  # cancellation too
            answer.broke_off(type(error).__name__)
            raise


class _Answer:
    """Passes an answer on. Its start waits for the first piece of the body, which tells why something is refused."""

    def __init__(self, scope: Scope, trail: Trail, send: Send) -> None:
        self._scope, self._trail, self._send = scope, trail, send
        self._start: Message | None = None
        self._told = False

    async def send(self, message: Message) -> None:
        kind = message["type"]
        if self._told or self._trail.hushed:
            await self._send(message)
        elif kind == "http.response.start" and (self._trail.changes or message["status"] in _REFUSED):
            self._start = message
        elif kind == "http.response.body" and self._start is not None:
            status: int = self._start["status"]
            await self._tell(status, _reason(message.get("body", b"")) if status >= HTTPStatus.BAD_REQUEST else "")
            await self._send(self._start)
            await self._send(message)
        elif kind == "websocket.close":  # before it was accepted
            await self._tell(HTTPStatus.FORBIDDEN, message.get("reason") or "")
            await self._send(message)
        else:
            self._told = True
            await self._send(message)

    def broke_off(self, why: str) -> None:
        if not self._told and self._trail.changes:
            put(self._scope, self._trail.outcome(HTTPStatus.INTERNAL_SERVER_ERROR, why))

    async def _tell(self, status: int, why: str) -> None:
        self._told = True
        entry = put(self._scope, self._trail.outcome(status, why))
        if not (self._trail.stop or self._trail.unwritten):
            with suppress(NotAudited):  # the log has it; nothing is undone by that
                await written(entry)


def _reason(body: bytes) -> str:
    try:
        problem: object = json.loads(body)
    except ValueError:
        return ""
    return str(cast("dict[str, Any]", problem).get("detail", "")) if isinstance(problem, dict) else ""
