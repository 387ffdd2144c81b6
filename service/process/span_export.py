"""Spans of OpenTelemetry's SDK, sent by OTLP over HTTP from a separate thread. Nothing waits for the collector."""

import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from importlib.metadata import version

import structlog
from opentelemetry import context as contexts
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import Resource
from opentelemetry.sdk.trace import ReadableSpan, SpanProcessor, TracerProvider
from opentelemetry.sdk.trace.export import SpanExportResult
from opentelemetry.trace import Status, StatusCode, set_span_in_context
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

from service.process.settings import Telemetry

_log = structlog.get_logger(__name__)


class SpanExport(SpanProcessor):
    """Makes spans, queues ended ones, and sends them from its thread."""

    def __init__(
        self, settings: Telemetry, machine: str, part: str, *, waiting: int = 2048, answer: float = 5.0
    ) -> None:
        """At most `waiting` spans wait; further ones are dropped and counted. `answer`: s for one request."""
        self._waiting, self._answer = waiting, answer
        authority = None if settings.authority is None else str(settings.authority)
        self._otlp = OTLPSpanExporter(f"{settings.endpoint}/v1/traces", certificate_file=authority, timeout=answer)
        own = version("sweepid")
        names = {"service.name": "sweepid", "service.namespace": part, "service.instance.id": machine}
        self._provider = TracerProvider(
            resource=Resource.create({**names, "service.version": own}), shutdown_on_exit=False
        )
        self._tracer = self._provider.get_tracer("sweepid", own)
        self._context = TraceContextTextMapPropagator()
        self._ended: deque[ReadableSpan] = deque()
        self._closing = threading.Event()
        self._trouble = False
        self.dropped = 0
        """Spans that were not sent."""
        self._thread = threading.Thread(target=self._send_all, name="telemetry", daemon=True)
        self._thread.start()
        self._provider.add_span_processor(self)

    @contextmanager
    def span(
        self, name: str, parent: str, attributes: Mapping[str, str | float]
    ) -> Generator[Callable[[str, str | float], None]]:
        """`parent`: a traceparent, or "" for the enclosing span. Given is what sets an attribute."""
        around = self._context.extract({"traceparent": parent}) if parent else None
        span = self._tracer.start_span(name, around, attributes=attributes)
        token = contexts.attach(set_span_in_context(span, around))
        try:
            yield span.set_attribute
        except BaseException as error:
            span.set_status(Status(StatusCode.ERROR, f"{type(error).__name__}: {error}"))
            raise
        finally:
            contexts.detach(token)
            span.end()

    @property
    def traceparent(self) -> str:
        """Traceparent of the span that encloses the call; "" without one."""
        carrier: dict[str, str] = {}
        self._context.inject(carrier)
        return carrier.get("traceparent", "")

    def close(self) -> None:
        """Send the queued spans, once; takes at most the time of one answer."""
        self._provider.shutdown()

    def on_end(self, span: ReadableSpan) -> None:
        if len(self._ended) >= self._waiting:
            self.dropped += 1
        else:
            self._ended.append(span)

    def shutdown(self) -> None:
        self._closing.set()
        self._thread.join(2 * self._answer)
        self._otlp.shutdown()

    def force_flush(self, timeout_millis: int = 30000) -> bool:
        return not self._ended

    def _send_all(self) -> None:
        if sys.platform == "linux":
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 10)  # of this thread only
        while not self._closing.wait(2.0):  # s, to send several spans together
            self._send()
        self._send()

    def _send(self) -> None:
        while self._ended:
            spans = [self._ended.popleft() for _ in range(min(256, len(self._ended)))]
            sent = self._otlp.export(spans) is SpanExportResult.SUCCESS
            if not sent:
                self.dropped += len(spans)
            if sent == self._trouble:
                _log.info("traces", sent=sent, dropped=self.dropped)
            self._trouble = not sent
            if not sent:
                return
