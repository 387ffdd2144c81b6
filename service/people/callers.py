"""Who a request can be from: the bearer of a key, or a person with a session."""

from datetime import datetime
from typing import Protocol

from service.people.permissions import Role


class Caller(Protocol):
    """Somebody that the service knows."""

    @property
    def name(self) -> str: ...

    @property
    def role(self) -> Role: ...

    @property
    def scopes(self) -> tuple[str, ...] | None:
        """What it is limited to, within its role; None: nothing but that."""
        ...

    def trouble(self, at: datetime) -> str:
        """Why it opens nothing at that time; empty if it does."""
        ...


class Callers(Protocol):
    """Where they are looked up."""

    def find(self, key: str) -> Caller | None:
        """Blocks. `key`: what was shown; those that open nothing any more are found too."""
        ...
