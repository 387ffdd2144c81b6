"""Data of a request for the audit, and how its entries are written."""

import asyncio
from concurrent.futures import Future
from dataclasses import dataclass, field

from starlette.types import Scope

from service.store.access.audit_chain import Entry, Fact
from service.store.access.credentials import masked
from service.store.access.permissions import SIGN_OF_LIFE, SOCKET, Role, Route
from service.store.people.audit import NotAudited
from service.web.application import Application

_TRAIL = "sweepid.trail"  # in the scope
_PATIENCE = 10.0  # s; afterwards an entry that is not on disk counts as not written
_LONGEST = 500  # characters
_READING = ("GET", "HEAD", "OPTIONS", SOCKET)


@dataclass
class AuditTrail:
    """One request. `route`: its key in the table of permissions; `request`: number of its first audit entry.

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
    route: Route | None = None
    stop: bool = False
    hushed: bool = False
    unwritten: bool = False
    key: str = ""
    session: int | None = None
    facts: dict[str, Fact] = field(default_factory=dict[str, Fact])
    request: int | None = None

    @property
    def changes(self) -> bool:
        return self.method not in _READING and self.route != SIGN_OF_LIFE

    def entry(self, event: str, **facts: Fact) -> Entry:
        return {
            "event": event,
            "actor": self.actor,
            "role": None if self.role is None else self.role.word,
            "address": self.address,
            "method": self.method,
            "route": None if self.route is None else self.route[1],
            "path": masked(self.path)[:_LONGEST],
            **facts,
        }

    def outcome(self, status: int, why: str) -> Entry:
        return self.entry("outcome", status=status, why=masked(why)[:_LONGEST], request=self.request, **self.facts)


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
        return await asyncio.wait_for(asyncio.wrap_future(future), _PATIENCE)
    except TimeoutError:
        raise NotAudited(f"the audit entry was not written within {_PATIENCE:g} s") from None
