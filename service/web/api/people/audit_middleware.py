"""Writes to the audit the outcome of each change, and of each request refused for its caller.

A stop waits for no entry. Every other answer waits until its outcome is on disk, or until that is known to be
impossible (then the log has it, and the entry `request` of a change has no outcome). A request that was refused
because its first entry could not be written is answered immediately.
"""

import json
from contextlib import suppress
from http import HTTPStatus
from typing import Any, cast

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.store.access.permissions import Permissions
from service.store.people.audit import NotAudited
from service.web.api.people.audit_trail import AuditTrail, begin_audit_trail, put, written

_REFUSED = (HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN, HTTPStatus.TOO_MANY_REQUESTS)


class AuditMiddleware:
    """ASGI middleware."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._permissions = Permissions()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        trail = begin_audit_trail(scope)
        trail.route = self._permissions.entry(trail.method, trail.path)
        answer = _Answer(scope, trail, send)
        try:
            await self._app(scope, receive, answer.send)
        except BaseException as error:  # also at cancellation
            answer.broke_off(type(error).__name__)
            raise


class _Answer:
    """Forwards an answer. Its start waits for the first part of the body, which contains the reason of a refusal."""

    def __init__(self, scope: Scope, trail: AuditTrail, send: Send) -> None:
        self._scope, self._trail, self._send = scope, trail, send
        self._start: Message | None = None
        self._written = False

    async def send(self, message: Message) -> None:
        kind = message["type"]
        if self._written or self._trail.hushed:
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
            self._written = True
            await self._send(message)

    def broke_off(self, why: str) -> None:
        if not self._written and self._trail.changes:
            put(self._scope, self._trail.outcome(HTTPStatus.INTERNAL_SERVER_ERROR, why))

    async def _tell(self, status: int, why: str) -> None:
        self._written = True
        entry = put(self._scope, self._trail.outcome(status, why))
        if not (self._trail.stop or self._trail.unwritten):
            with suppress(NotAudited):  # the log has the entry; the answer is sent anyway
                await written(entry)


def _reason(body: bytes) -> str:
    try:
        problem: object = json.loads(body)
    except ValueError:
        return ""
    return str(cast("dict[str, Any]", problem).get("detail", "")) if isinstance(problem, dict) else ""
