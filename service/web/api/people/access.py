"""Authentication and authorization of each request, after the gate and before its body is read.

With `login: false` every caller is `local` with all rights. A stop needs no authentication and waits for nothing. A
change is refused if its first audit entry cannot be written; so is, for a while, an address with many wrong keys.
"""

import time
from http import HTTPStatus

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from service.store.access.credentials import Caller, key_sha256
from service.store.access.permissions import LOCAL, LOGINS, PERMISSIONS, STOP, Permissions, Role, lacking
from service.store.people.audit import NotAudited
from service.web.api.gate import from_own_page
from service.web.api.people.audit_trail import AuditTrail, audit_trail_of, put, written
from service.web.api.people.credentials import Credentials, shown
from service.web.api.people.rate_limit import Guesses
from service.web.api.people.refusals import too_many, unauthorized
from service.web.api.problem import AGAIN, Refused
from service.web.application import Application

_ANYBODY = "anybody"
_POLICY = 1008  # close code of WebSockets: policy violation


class Access:
    """ASGI middleware, inside `AuditMiddleware`."""

    def __init__(self, app: ASGIApp, login: bool, guesses: Guesses) -> None:
        """`guesses`: limits the wrong keys of an address."""
        self._app = app
        self._login = login
        self._guesses = guesses
        self._permissions = Permissions()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        trail = audit_trail_of(scope)
        trail.route = self._permissions.entry(trail.method, scope["path"])
        trail.stop = trail.route == STOP
        if trail.stop and self._login:
            trail.key = shown(scope).key
        try:
            if not self._login:
                trail.actor, trail.role = LOCAL, Role.ADMIN
            elif trail.route is not None and PERMISSIONS[trail.route] is None:
                trail.actor = _ANYBODY
            else:
                await self._identify(scope, trail)
            if trail.changes and trail.route not in (STOP, *LOGINS):  # a login has one entry, with its outcome
                trail.request = await _begin(scope, trail)
        except Refused as refused:
            await _answer(refused, scope, receive, send)
            return
        await self._app(scope, receive, send)

    async def _identify(self, scope: Scope, trail: AuditTrail) -> None:
        given = shown(scope)
        if not given.key:
            raise unauthorized("not authenticated: send the header Authorization: Bearer KEY, or log in")
        if given.cookie and trail.changes and not from_own_page(Headers(scope=scope)):
            detail = (
                "request with a session cookie that does not come from a page of this service: "
                "programs send a key, as Authorization: Bearer KEY"
            )
            raise Refused(HTTPStatus.FORBIDDEN, "foreign-request", detail)
        application: Application = scope["app"].state.application
        found = await self._find(application, given, trail)
        trail.actor, trail.role, trail.scopes = found.name, found.role, found.scopes
        if trouble := found.trouble(application.api_keys.now()):
            raise unauthorized(trouble)
        if needed := lacking(found.role, found.scopes, trail.route):
            limited = "" if found.scopes is None else f", limited to {', '.join(found.scopes)}"
            detail = (
                f"{trail.method} {scope['path']} requires {needed}; {found.name} has the role "
                f"{found.role.word}{limited}"
            )
            raise Refused(HTTPStatus.FORBIDDEN, "forbidden", detail)

    async def _find(self, application: Application, given: Credentials, trail: AuditTrail) -> Caller:
        value, guesses = key_sha256(given.key), self._guesses
        if wait := guesses.wait(trail.address, value, time.monotonic()):
            trail.hushed = not guesses.first_refusal(trail.address)
            raise too_many(f"wrong keys from {trail.address}", wait)
        found: Caller | None = None
        if given.cookie:
            found = session = await run_in_threadpool(application.sessions.find, given.key)
            trail.session = None if session is None else session.id
        else:
            found = await run_in_threadpool(application.api_keys.find, given.key)
        if found is None or value is None:
            guesses.wrong(trail.address, time.monotonic())
            raise unauthorized(
                f"this {'session' if given.cookie else 'key'} is not known to the service: log in again, "
                "or create a key with `sweepid people add-key`"
            )
        guesses.opened(value)
        return found


async def _begin(scope: Scope, trail: AuditTrail) -> int:
    try:
        return await written(put(scope, trail.entry("request")))
    except NotAudited as error:
        trail.unwritten = True
        detail = f"not executed: {error}"
        raise Refused(HTTPStatus.SERVICE_UNAVAILABLE, "not-audited", detail, AGAIN) from None


async def _answer(refused: Refused, scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": _POLICY, "reason": refused.detail[:120]})
        return
    await refused.response(Request(scope))(scope, receive, send)
