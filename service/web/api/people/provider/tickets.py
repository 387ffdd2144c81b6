"""Logins in progress at the identity provider: each is valid for one browser, once, for a limited time. Pure."""

import secrets
from collections import OrderedDict
from dataclasses import dataclass

LASTS = 600.0  # s to log in at the provider
MOST = 1000  # logins in progress; the oldest is removed first

_BYTES = 32


@dataclass(frozen=True)
class Ticket:
    """`state` returns with the code, `nonce` in the ID token; `verifier` (PKCE, RFC 7636) proves who started the login.

    `page`: the page to which the browser returns. `ends`: s, monotonic.
    """

    state: str
    nonce: str
    verifier: str
    page: str
    ends: float


class Tickets:
    """By the value of the browser's cookie. A time `now` is in s and monotonic."""

    def __init__(self) -> None:
        self._open: OrderedDict[str, Ticket] = OrderedDict()

    def issue(self, page: str, now: float) -> tuple[str, Ticket]:
        """The value of the cookie, and the ticket."""
        cookie, state, nonce, verifier = (secrets.token_urlsafe(_BYTES) for _ in range(4))
        ticket = self._open[cookie] = Ticket(state, nonce, verifier, page, now + LASTS)
        if len(self._open) > MOST:
            self._open.popitem(last=False)
        return cookie, ticket

    def take(self, cookie: str, state: str, now: float) -> Ticket | None:
        """The ticket of this browser; None if it has expired or `state` is wrong. The ticket is always removed."""
        ticket = self._open.pop(cookie, None)
        if ticket is None or now >= ticket.ends:
            return None
        return ticket if secrets.compare_digest(ticket.state.encode(), state.encode()) else None
