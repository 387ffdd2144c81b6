"""Spans of a trace: a request, its campaign, each sweep, its identification, the job of the worker.

Without the setting `otel` a span has no cost. A span belongs to the enclosing span in the same context, also in tasks
and threads started there; other processes get its `traceparent` (W3C Trace Context).
"""

from collections.abc import Generator
from contextlib import contextmanager
from typing import Protocol

Attribute = str | int | float


class Exporting(Protocol):
    """Creates and sends spans."""

    def begin(self, name: str, parent: str, attributes: dict[str, Attribute]) -> "Current":
        """`parent`: a traceparent, or "" for the enclosing span."""
        ...

    @property
    def traceparent(self) -> str:
        """Traceparent of the span that encloses the call; "" without one."""
        ...

    @property
    def dropped(self) -> int:
        """Number of spans that were not sent."""
        ...


class Current(Protocol):
    """A span that has begun."""

    def note(self, name: str, value: Attribute) -> None: ...

    def end(self, error: BaseException | None) -> None: ...


class _Nothing:
    def note(self, name: str, value: Attribute) -> None:
        pass

    def end(self, error: BaseException | None) -> None:
        pass


class Tracing:
    """One instance per process, like the log."""

    def __init__(self) -> None:
        self.exporting: Exporting | None = None

    @property
    def traceparent(self) -> str:
        """For a process that works for this one; "" without a trace."""
        return "" if self.exporting is None else self.exporting.traceparent

    @property
    def dropped(self) -> int | None:
        """Number of spans that were not sent; None if traces are disabled."""
        return None if self.exporting is None else self.exporting.dropped

    @contextmanager
    def span(self, name: str, parent: str = "", **attributes: Attribute) -> Generator[Current]:
        """The block is a span. An attribute `campaign` is sent as `sweepid.campaign`."""
        if self.exporting is None:
            yield _Nothing()
            return
        named = {f"sweepid.{key}": value for key, value in attributes.items()}
        current = self.exporting.begin(name, parent, named)
        try:
            yield current
        except BaseException as error:
            current.end(error)
            raise
        current.end(None)


TRACING = Tracing()
