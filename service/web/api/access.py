"""Authentication and authorization of each request, after the gate and before its body is read.

With `login: false` every caller is `local` with all rights. A stop needs no authentication and waits for nothing. A
change is refused if its first audit entry cannot be written; so is, for a while, an address with many wrong keys.
"""

import asyncio
import json
import math
import time
from collections import OrderedDict, deque
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from http import HTTPStatus
from ipaddress import IPv6Address, ip_address
from typing import Any, cast

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import Request, cookie_parser
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.store.access import LOCAL, Caller, Role, bearer, key_sha256, masked
from service.store.people.audit import Entry, Fact, NotAudited
from service.store.table_rows import NoMachine
from service.web.api.gate import from_own_page, refuse
from service.web.api.problem import AGAIN, RequestRefused, problem_response
from service.web.api.route_roles import API, LOGINS, SIGN_OF_LIFE, SOCKET, STOP, Permissions, RouteKey
from service.web.application import Application

_TRAIL = "sweepid.trail"  # in the scope
_PATIENCE = 10.0  # s; afterwards an entry that is not on disk counts as not written


@dataclass
class AuditTrail:
    """One request. `route`: its key in `Permissions`; `request`: number of its first audit entry.

    `session`: number of the caller's session, if any. `hushed`: no entry, because a similar one exists already.
    `unwritten`: the first entry could not be written, so nothing was done. `key`: the key of a stop. A stop does not
    wait for its check: the caller is identified when the entry is written. `facts`: data of a route for the outcome.
    """

    method: str
    path: str
    address: str
    actor: str = "unknown"
    role: Role | None = None
    scopes: tuple[str, ...] | None = None
    route: RouteKey | None = None
    stop: bool = False
    hushed: bool = False
    unwritten: bool = False
    key: str = ""
    session: int | None = None
    facts: dict[str, Fact] = field(default_factory=dict[str, Fact])
    request: int | None = None

    @property
    def changes(self) -> bool:
        return self.method not in ("GET", "HEAD", "OPTIONS", SOCKET) and self.route != SIGN_OF_LIFE

    def entry(self, event: str, **facts: Fact) -> Entry:
        return {
            "event": event,
            "actor": self.actor,
            "role": None if self.role is None else self.role.word,
            "address": self.address,
            "method": self.method,
            "route": None if self.route is None else self.route[1],
            "path": masked(self.path)[:500],
            **facts,
        }

    def outcome(self, status: int, why: str) -> Entry:
        return self.entry("outcome", status=status, why=masked(why)[:500], request=self.request, **self.facts)


def begin_audit_trail(scope: Scope) -> AuditTrail:
    client = scope.get("client")
    method = str(scope.get("method", SOCKET))[:20]
    scope[_TRAIL] = trail = AuditTrail(method, scope["path"], "unknown" if client is None else str(client[0]))
    return trail


def audit_trail_of(scope: Scope) -> AuditTrail:
    return scope[_TRAIL]


def put(scope: Scope, entry: Entry) -> "Future[int]":
    """Does not wait. The entry of a stop is kept until the database accepts it."""
    application: Application | None = getattr(scope["app"].state, "application", None)
    trail = audit_trail_of(scope)
    if application is not None:
        write = application.audit.keep if trail.stop else application.audit.put
        return write(entry, trail.key)
    future: Future[int] = Future()
    future.set_exception(NotAudited("the application runs outside its lifespan: there is no audit"))
    return future


async def written(future: "Future[int]") -> int:
    """The number of the entry when it is on disk. NotAudited if it is not written in time."""
    try:
        async with asyncio.timeout(_PATIENCE):
            return await asyncio.wrap_future(future)
    except TimeoutError:
        raise NotAudited(f"the audit entry was not written within {_PATIENCE:g} s") from None


LIVE = "sweepid.live"


@dataclass(frozen=True)
class Presented:
    """`key`: empty without credentials. `cookie`: the browser sent it automatically, for a page of any origin."""

    key: str
    cookie: bool


def presented(scope: Scope) -> Presented:
    """The header has priority over the cookie: a header is never sent automatically."""
    headers = Headers(scope=scope)
    if key := bearer(headers.get("authorization", "")) or _of_subprotocol(scope):
        return Presented(key, cookie=False)
    return Presented(cookie_parser(headers.get("cookie", "")).get(cookie_name(scope), ""), cookie=True)


def cookie_name(scope: Scope) -> str:
    """Depends on the port that the browser sees: all ports of a computer share their cookies; each cell has a port."""
    port = Headers(scope=scope).get("host", "").rpartition("]")[2].rpartition(":")[2]
    return f"sweepid-{port}" if port.isascii() and port.isdigit() else "sweepid"


def _of_subprotocol(scope: Scope) -> str:
    """The key from the subprotocols of a WebSocket, or empty."""
    start = "sweepid.key."
    return next((name.removeprefix(start) for name in scope.get("subprotocols", ()) if name.startswith(start)), "")


WINDOW = 60.0  # s


@dataclass(slots=True)
class _Attempts:
    """Times of the last wrong keys, s; `reported`: the refusal after them is already in the audit."""

    times: deque[float]
    reported: bool = False


class Guesses:
    """Counts wrong keys. `most`: per address within a minute; the next one waits. A time `now` is in s, monotonic."""

    most = 1000  # addresses, and keys that were accepted

    def __init__(self, most: int) -> None:
        self._most = most
        self._wrong: OrderedDict[str, _Attempts] = OrderedDict()
        self._opened: OrderedDict[str, None] = OrderedDict()

    def wait(self, address: str, key_sha256: str | None, now: float) -> float:
        """Time until this key from this address is checked, s; 0: now. A key that was accepted before is always
        checked: wrong keys of others behind the same proxy do not lock out its owner."""
        found = self._wrong.get(_place(address))
        if found is None or len(found.times) < self._most or key_sha256 in self._opened:
            return 0.0
        return max(0.0, found.times[0] + WINDOW - now)

    def check(self, address: str, key_sha256: str | None, what: str, trail: AuditTrail) -> None:
        """RequestRefused while the key has to wait, for too many `what`; the audit has the first refusal alone."""
        if wait := self.wait(address, key_sha256, time.monotonic()):
            trail.hushed = not self.first_refusal(address)
            raise too_many(what, wait)

    def __len__(self) -> int:
        """Number of addresses and keys in the tables."""
        return len(self._wrong) + len(self._opened)

    def first_refusal(self, address: str) -> bool:
        """Whether this is the first refusal since the last checked attempt: only this one is written to the audit."""
        found = self._wrong.get(_place(address))
        first = found is not None and not found.reported
        if found is not None:
            found.reported = True
        return first

    def wrong(self, address: str, now: float) -> None:
        """Count a key that was checked and is wrong."""
        place = _place(address)
        found = self._wrong.setdefault(place, _Attempts(deque(maxlen=self._most)))
        found.times.append(now)
        found.reported = False
        self._wrong.move_to_end(place)
        if len(self._wrong) > Guesses.most:
            self._wrong.popitem(last=False)

    def opened(self, key_sha256: str) -> None:
        """Remember a key that was checked and accepted."""
        self._opened[key_sha256] = None
        self._opened.move_to_end(key_sha256)
        if len(self._opened) > Guesses.most:
            self._opened.popitem(last=False)


def _place(address: str) -> str:
    """The network of an IPv6 address: its owner has 2^64 addresses. An IPv4 address itself."""
    try:
        found = ip_address(address)
    except ValueError:  # of a socket without address
        return address
    if isinstance(found, IPv6Address):
        return str(found.ipv4_mapped or int(found) >> 64)
    return str(found)


def unauthorized(detail: str) -> RequestRefused:
    return RequestRefused(
        HTTPStatus.UNAUTHORIZED, "unauthorized", detail, {"WWW-Authenticate": 'Bearer realm="sweepid"'}
    )


def too_many(what: str, wait: float) -> RequestRefused:
    """`wait`: s until the next attempt is checked."""
    seconds = math.ceil(wait)
    detail = f"too many {what} within {WINDOW:g} s: wait {seconds} s. STOP works without a login"
    return RequestRefused(HTTPStatus.TOO_MANY_REQUESTS, "too-many-wrong-keys", detail, {"Retry-After": str(seconds)})


class Access:
    """ASGI middleware, inside `AuditMiddleware`."""

    def __init__(self, app: ASGIApp, login: bool, guesses: Guesses, permissions: Permissions) -> None:
        """`guesses`: limits the wrong keys of an address."""
        self._app = app
        self._login = login
        self._guesses = guesses
        self._permissions = permissions

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        trail = audit_trail_of(scope)
        trail.stop = trail.route == STOP
        if trail.stop and self._login:
            trail.key = presented(scope).key
        try:
            if not self._login:
                trail.actor, trail.role = LOCAL, Role.ADMIN
            elif trail.route is not None and self._permissions.roles[trail.route] is None:
                trail.actor = "anybody"
            else:
                await self._identify(scope, trail)
            if trail.changes and trail.route not in (STOP, *LOGINS):  # a login has one entry, with its outcome
                trail.request = await _begin(scope, trail)
        except RequestRefused as refused:
            await refuse(refused, scope, receive, send)
            return
        await self._app(scope, receive, send)

    async def _identify(self, scope: Scope, trail: AuditTrail) -> None:
        given = presented(scope)
        if not given.key:
            raise unauthorized("not authenticated: send the header Authorization: Bearer KEY, or log in")
        if given.cookie and trail.changes and not from_own_page(Headers(scope=scope)):
            detail = (
                "request with a session cookie that does not come from a page of this service: "
                "programs send a key, as Authorization: Bearer KEY"
            )
            raise RequestRefused(HTTPStatus.FORBIDDEN, "foreign-request", detail)
        application: Application = scope["app"].state.application
        found = await self._find(application, given, trail)
        trail.actor, trail.role, trail.scopes = found.name, found.role, found.scopes
        if trouble := found.trouble(application.api_keys.now()):
            raise unauthorized(trouble)
        if needed := self._permissions.lacking(found.role, found.scopes, trail.route):
            limited = "" if found.scopes is None else f", limited to {', '.join(found.scopes)}"
            detail = (
                f"{trail.method} {scope['path']} requires {needed}; {found.name} has the role "
                f"{found.role.word}{limited}"
            )
            raise RequestRefused(HTTPStatus.FORBIDDEN, "forbidden", detail)

    async def _find(self, application: Application, given: Presented, trail: AuditTrail) -> Caller:
        value, guesses = key_sha256(given.key), self._guesses
        guesses.check(trail.address, value, f"wrong keys from {trail.address}", trail)
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
        raise RequestRefused(HTTPStatus.SERVICE_UNAVAILABLE, "not-audited", detail, AGAIN) from None


class ReadOnlyService:
    """ASGI middleware inside `Access`: callers without permission get that answer first. The audit has the refusal."""

    allowed = (STOP, *LOGINS, ("POST", f"{API}/logout"))  # the route of the stop answers a stop itself: 503, no machine

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            trail = audit_trail_of(scope)
            if trail.changes and trail.route is not None and trail.route not in ReadOnlyService.allowed:
                refusal = problem_response(Request(scope), HTTPStatus.CONFLICT, "no-machine", str(NoMachine()))
                await refusal(scope, receive, send)
                return
        await self._app(scope, receive, send)


class AuditMiddleware:
    """ASGI middleware."""

    def __init__(self, app: ASGIApp, permissions: Permissions) -> None:
        self._app, self._permissions = app, permissions

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
        elif kind == "http.response.start" and (self._trail.changes or message["status"] in (401, 403, 429)):
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
