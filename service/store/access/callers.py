"""The possible callers of a request: the owner of a key, or a person with a session."""

from datetime import datetime
from typing import Protocol

from service.store.access.permissions import Role


class Caller(Protocol):
    """An authenticated caller."""

    @property
    def name(self) -> str: ...

    @property
    def role(self) -> Role: ...

    @property
    def scopes(self) -> tuple[str, ...] | None:
        """The scopes of the caller, within his role; None: no limit but the role."""
        ...

    def trouble(self, at: datetime) -> str:
        """Why the caller is not accepted at that time; empty if accepted."""
        ...


class Callers(Protocol):
    """A store of callers."""

    def now(self) -> datetime:
        """The time by which these callers expire; it never runs backward."""
        ...

    def find(self, key: str) -> Caller | None:
        """Blocks. `key`: as sent by the caller; also finds callers that are no longer accepted."""
        ...
