"""What is known of a request for the audit, and how its entries come there."""

import asyncio
from concurrent.futures import Future
from dataclasses import dataclass, field

from starlette.types import Scope

from service.application import Application
from service.people.chain import Entry, Fact
from service.people.keys import masked
from service.people.permissions import SIGN_OF_LIFE, SOCKET, Role, Route
from service.store.people.writer import NotAudited

_TRAIL = "sweepid.trail"  # in the scope
_PATIENCE = 10.0  # s until an entry that is not on disk counts as none
_LONGEST = 500  # characters
_READING = ("GET", "HEAD", "OPTIONS", SOCKET)


@dataclass
class Trail:
    """One request. `route`: its entry in the table of permissions; `request`: number of the entry from before it.

    `session`: the number of the one that asks, if one does. `hushed`: one like it was told, and this one is not.
    `unwritten`: its beginning could not be written, so nothing was done. `key`: shown with a stop, which waits for no
    look at it: who it belongs to is found out when the entry is written. `told`: what a route adds to the outcome.
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
    told: dict[str, Fact] = field(default_factory=dict[str, Fact])
    request: int | None = None

    @property
    def changes(self) -> bool:
        return self.method not in _READING and self.route != SIGN_OF_LIFE

    def entry(self, event: str, **told: Fact) -> Entry:
        return {
            "event": event,
            "actor": self.actor,
            "role": None if self.role is None else self.role.word,
            "address": self.address,
            "method": self.method,
            "route": None if self.route is None else self.route[1],
            "path": masked(self.path)[:_LONGEST],
            **told,
        }

    def outcome(self, status: int, why: str) -> Entry:
        return self.entry("outcome", status=status, why=masked(why)[:_LONGEST], request=self.request, **self.told)


def begin_trail(scope: Scope) -> Trail:
    client = scope.get("client")
    method = str(scope.get("method", SOCKET))[:20]
    scope[_TRAIL] = trail = Trail(method, scope["path"], "unknown" if client is None else str(client[0]))
    return trail


def trail_of(scope: Scope) -> Trail:
    return scope[_TRAIL]


def put(scope: Scope, entry: Entry) -> "Future[int]":
    """Waits for nothing. That of a stop is kept until the database takes it."""
    application: Application | None = getattr(scope["app"].state, "application", None)
    trail = trail_of(scope)
    if application is not None:
        write = application.audit.keep if trail.stop else application.audit.put
        return write(entry, trail.key)
    future: Future[int] = Future()
    future.set_exception(NotAudited("the application runs outside its lifespan: there is no audit"))
    return future


async def written(future: "Future[int]") -> int:
    """The entry's number once it is on disk. NotAudited."""
    try:
        return await asyncio.wait_for(asyncio.wrap_future(future), _PATIENCE)
    except TimeoutError:
        raise NotAudited(f"the audit was not written within {_PATIENCE:g} s") from None
