"""Who is it, and may he? Asked of each request after the gate, before anything of it is read.

With `login: false` everybody is `local` with all rights. A stop is asked nothing and waits for nothing. A change whose
beginning cannot be written to the audit is refused, and so is, for a while, an address that showed too many wrong keys.
"""

import math
import time
from collections.abc import Mapping
from http import HTTPStatus

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from service.api.people.trail import Trail, put, trail_of, written
from service.api.problem import AGAIN, problem_response
from service.application import Application
from service.people.guesses import WINDOW, Guesses
from service.people.keys import bearer, key_sha256
from service.people.permissions import LOCAL, PERMISSIONS, STOP, Permissions, Role
from service.store.people.keys import KeyDocument
from service.store.people.writer import NotAudited
from service.store.tables import now

_CHALLENGE = {"WWW-Authenticate": 'Bearer realm="sweepid"'}
_ANYBODY = "anybody"
_POLICY = 1008  # close code of WebSockets: policy violation


class _Refused(Exception):
    def __init__(self, status: HTTPStatus, name: str, detail: str, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(detail)
        self.status, self.name, self.detail, self.headers = status, name, detail, headers


def _unauthorized(detail: str) -> _Refused:
    return _Refused(HTTPStatus.UNAUTHORIZED, "unauthorized", detail, _CHALLENGE)


class Access:
    """ASGI middleware, inside of `Audited`."""

    def __init__(self, app: ASGIApp, login: bool, wrong_keys: int) -> None:
        """`wrong_keys`: how many an address may show in a minute."""
        self._app = app
        self._login = login
        self._guesses = Guesses(wrong_keys)
        self._permissions = Permissions()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        trail = trail_of(scope)
        trail.route = self._permissions.entry(trail.method, scope["path"])
        trail.stop = trail.route == STOP
        if trail.stop and self._login:
            trail.key = _shown(scope)
        try:
            if not self._login:
                trail.actor, trail.role = LOCAL, Role.ADMIN
            elif trail.route is not None and PERMISSIONS[trail.route] is None:
                trail.actor = _ANYBODY
            else:
                await self._identify(scope, trail)
            if trail.changes and not trail.stop:
                trail.request = await _begin(scope, trail)
        except _Refused as refused:
            await _answer(refused, scope, receive, send)
            return
        await self._app(scope, receive, send)

    async def _identify(self, scope: Scope, trail: Trail) -> None:
        needed = self._permissions.needed(trail.method, scope["path"])
        given = _shown(scope)
        if not given:
            raise _unauthorized("no key: send Authorization: Bearer KEY")
        found = await self._find(scope["app"].state.application, given, trail)
        trail.actor, trail.role = found.name, found.role
        if trouble := found.trouble(now()):
            raise _unauthorized(trouble)
        if needed is not None and found.role < needed:
            detail = f"{trail.method} {scope['path']} needs {needed.word}; {found.name} is {found.role.word}"
            raise _Refused(HTTPStatus.FORBIDDEN, "forbidden", detail)

    async def _find(self, application: Application, given: str, trail: Trail) -> KeyDocument:
        shown, guesses = key_sha256(given), self._guesses
        if wait := guesses.wait(trail.address, shown, time.monotonic()):
            trail.hushed = not guesses.first_refusal(trail.address)
            seconds = math.ceil(wait)
            detail = (
                f"too many wrong keys from {trail.address} within {WINDOW:g} s: no further one is looked at "
                f"for {seconds} s; a stop needs none"
            )
            raise _Refused(HTTPStatus.TOO_MANY_REQUESTS, "too-many-wrong-keys", detail, {"Retry-After": str(seconds)})
        found = None if shown is None else await run_in_threadpool(application.api_keys.find, given)
        if found is None or shown is None:
            guesses.wrong(trail.address, time.monotonic())
            raise _unauthorized("this key is not one of the service's")
        guesses.opened(shown)
        return found


def _shown(scope: Scope) -> str:
    return bearer(Headers(scope=scope).get("authorization", ""))


async def _begin(scope: Scope, trail: Trail) -> int:
    try:
        return await written(put(scope, trail.entry("request")))
    except NotAudited as error:
        trail.unwritten = True
        detail = f"nothing was done, because {error}"
        raise _Refused(HTTPStatus.SERVICE_UNAVAILABLE, "not-audited", detail, AGAIN) from None


async def _answer(refused: _Refused, scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": _POLICY, "reason": refused.detail[:120]})
        return
    answer = problem_response(Request(scope), refused.status, refused.name, refused.detail, headers=refused.headers)
    await answer(scope, receive, send)
