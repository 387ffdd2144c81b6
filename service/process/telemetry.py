"""Spans of a trace: a request, its campaign, each sweep, its identification, the job of the worker.

Without the setting `otel` a span has no cost, and no library is loaded. A span belongs to the enclosing span in the
same context, also in tasks and threads started there; other processes get its `traceparent` (W3C Trace Context).
"""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from service.process.settings import Telemetry

if TYPE_CHECKING:  # needs the extra `otel`
    from service.process.span_export import SpanExport

Attribute = str | int | float
Note = Callable[[str, Attribute], None]


class Tracing:
    """One instance per process, like the log."""

    def __init__(self) -> None:
        self.export: SpanExport | None = None

    @property
    def traceparent(self) -> str:
        """For a process that works for this one; "" without a trace."""
        return "" if self.export is None else self.export.traceparent

    @property
    def dropped(self) -> int | None:
        """Number of spans that were not sent; None if traces are disabled."""
        return None if self.export is None else self.export.dropped

    @contextmanager
    def span(self, name: str, parent: str = "", **attributes: Attribute) -> Generator[Note]:
        """The block is a span, by default of the one that encloses it; with it comes what sets an attribute of it. An
        attribute `a` given here is sent as `sweepid.a`.
        """
        if self.export is None:
            yield lambda _name, _value: None
            return
        with self.export.span(name, parent, {f"sweepid.{key}": value for key, value in attributes.items()}) as note:
            yield note


TRACING = Tracing()


@contextmanager
def traced(traces: Telemetry | None, machine: str, part: str = "service") -> Generator[None]:
    """While it is open, spans of this process are sent as those of `part` (service, worker) of a machine."""
    if traces is None:
        yield
        return
    from service.process.span_export import SpanExport

    TRACING.export = export = SpanExport(traces, machine, part)
    try:
        yield
    finally:
        TRACING.export = None
        export.close()
