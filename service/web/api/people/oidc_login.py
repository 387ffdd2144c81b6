"""A login at an identity provider, from its start to the person: the state of the routes."""

import time
from importlib import import_module
from typing import TYPE_CHECKING

from service.model.errors import BadInput, Conflict
from service.process.settings import IdentityProvider
from service.store.access.permissions import Role
from service.web.api.people.audit_trail import AuditTrail
from service.web.api.people.provider.tickets import Tickets
from service.web.api.people.rate_limit import Guesses
from service.web.api.people.refusals import too_many, unauthorized
from service.web.api.problem import Refused

if TYPE_CHECKING:  # optional: only an installation with an identity provider needs Authlib
    from service.web.api.people.provider.exchange import Exchange
    from service.web.api.people.provider.id_token import Named

_MOST_WAITING = 8  # requests that wait for the provider


class OidcLogin:
    """Counts invalid states and codes together with the wrong keys and passwords of an address."""

    def __init__(self, exchange: "Exchange", guesses: Guesses) -> None:
        self.settings = exchange.settings
        self._exchange, self._guesses = exchange, guesses
        self._tickets = Tickets()
        self._waiting = 0

    def page(self, own: str) -> str:
        """The page to which browsers return. `own`: address of this request. Conflict if another page is configured."""
        if self.settings.page is None or self.settings.page.rstrip("/") == own.rstrip("/"):
            return self.settings.page or own
        raise Conflict(
            f"the identity provider redirects to {self.settings.page}: open the operator page at that address"
        )

    async def begin(self, own: str) -> tuple[str, str]:
        """The value of the cookie, and the address where the browser logs in. ProviderSilent; Conflict."""
        cookie, ticket = self._tickets.issue(self.page(own), time.monotonic())
        async with _Place(self):
            return cookie, await self._exchange.address(ticket)

    async def named(self, cookie: str, state: str, code: str, trail: AuditTrail) -> "Named":
        """The person that the provider names. Refused: 401 for invalid input, 429 for too many. ProviderSilent."""
        now = time.monotonic()
        if wait := self._guesses.wait(trail.address, None, now):
            trail.hushed = not self._guesses.first_refusal(trail.address)
            raise too_many(f"wrong keys, passwords and codes from {trail.address}", wait)
        ticket = self._tickets.take(cookie, state, now)
        if ticket is None:
            raise self._wrong("unknown or expired login state in this browser: start the login again", trail)
        library = import_module("service.web.api.people.provider.id_token")
        try:
            async with _Place(self):
                return await self._exchange.named(code, ticket)
        except library.BadIdToken as error:
            raise self._wrong(str(error), trail) from None

    def role(self, groups: tuple[str, ...]) -> Role | None:
        """The highest role of these groups here; None without one."""
        return max(
            (Role[self.settings.roles[one].upper()] for one in groups if one in self.settings.roles), default=None
        )

    def enter(self) -> None:
        """Refused if too many requests wait."""
        if self._waiting >= _MOST_WAITING:
            raise too_many("logins at the identity provider", 1.0)
        self._waiting += 1

    def leave(self) -> None:
        self._waiting -= 1

    def _wrong(self, detail: str, trail: AuditTrail) -> Refused:
        self._guesses.wrong(trail.address, time.monotonic())
        return unauthorized(detail)


class _Place:
    """One of the few places of requests that may wait for the provider at the same time."""

    def __init__(self, of: OidcLogin) -> None:
        self._of = of

    async def __aenter__(self) -> None:
        self._of.enter()

    async def __aexit__(self, *_: object) -> None:
        self._of.leave()


def open_oidc(settings: IdentityProvider | None, guesses: Guesses) -> OidcLogin | None:
    """None if no provider is set. BadInput if the extra or the file of the secret is missing."""
    if settings is None:
        return None
    try:
        library = import_module("service.web.api.people.provider.exchange")
    except ImportError as error:
        raise BadInput("oidc", f"requires sweepid[oidc], which is not installed ({error})") from None
    return OidcLogin(library.Exchange(settings), guesses)
