"""Spans of OpenTelemetry's SDK, sent by OTLP over HTTP from a separate thread.

At most `WAITING` spans wait; further ones are dropped and counted. Nothing waits for the collector.
"""

import contextlib
import os
import sys
import threading
from collections import deque
from collections.abc import Generator
from contextvars import Token
from importlib.metadata import version

import structlog
from opentelemetry import context as contexts
from opentelemetry.context import Context
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import Resource
from opentelemetry.sdk.trace import ReadableSpan, SpanProcessor, TracerProvider
from opentelemetry.sdk.trace.export import SpanExporter, SpanExportResult
from opentelemetry.trace import Span, Status, StatusCode, set_span_in_context
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

from service.process.settings.telemetry import Telemetry
from service.process.telemetry.spans import TRACING, Attribute

_log = structlog.get_logger(__name__)

WAITING = 2048  # spans
_AT_ONCE = 256  # spans in one request
_PAUSE = 2.0  # s between requests, to send several spans together
_ANSWER = 5.0  # s for one request
_NICE = 10
_HEADER = "traceparent"
_PROPAGATOR = TraceContextTextMapPropagator()


class Sender(SpanProcessor):
    """Queues ended spans, and sends them from its thread."""

    def __init__(self, exporter: SpanExporter) -> None:
        self._exporter = exporter
        self._ended: deque[ReadableSpan] = deque()
        self._closing = threading.Event()
        self._trouble = False
        self.dropped = 0
        """Spans that were not sent."""
        self._thread = threading.Thread(target=self._send_all, name="telemetry", daemon=True)
        self._thread.start()

    def on_end(self, span: ReadableSpan) -> None:
        if len(self._ended) >= WAITING:
            self.dropped += 1
        else:
            self._ended.append(span)

    def shutdown(self) -> None:
        """Send the queued spans, once; takes at most the time of one answer."""
        self._closing.set()
        self._thread.join(2 * _ANSWER)
        self._exporter.shutdown()

    def force_flush(self, timeout_millis: int = 30000) -> bool:
        return not self._ended

    def _send_all(self) -> None:
        if sys.platform == "linux":
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)  # of this thread only
        while not self._closing.wait(_PAUSE):
            self._send()
        self._send()

    def _send(self) -> None:
        while self._ended:
            spans = [self._ended.popleft() for _ in range(min(_AT_ONCE, len(self._ended)))]
            sent = self._exporter.export(spans) is SpanExportResult.SUCCESS
            if not sent:
                self.dropped += len(spans)
            if sent == self._trouble:
                _log.info("traces", sent=sent, dropped=self.dropped)
            self._trouble = not sent
            if not sent:
                return


class _Current:
    def __init__(self, span: Span, token: "Token[Context]") -> None:
        self._span, self._token = span, token

    def note(self, name: str, value: Attribute) -> None:
        self._span.set_attribute(name, value)

    def end(self, error: BaseException | None) -> None:
        if error is not None:
            self._span.set_status(Status(StatusCode.ERROR, f"{type(error).__name__}: {error}"))
        contexts.detach(self._token)
        self._span.end()


class _Exporting:
    def __init__(self, provider: TracerProvider, sender: Sender) -> None:
        self._sender = sender
        self._tracer = provider.get_tracer("sweepid", version("sweepid"))

    def begin(self, name: str, parent: str, attributes: dict[str, Attribute]) -> _Current:
        around = _PROPAGATOR.extract({_HEADER: parent}) if parent else None
        span = self._tracer.start_span(name, around, attributes=attributes)
        return _Current(span, contexts.attach(set_span_in_context(span, around)))

    @property
    def dropped(self) -> int:
        return self._sender.dropped

    @property
    def traceparent(self) -> str:
        carrier: dict[str, str] = {}
        _PROPAGATOR.inject(carrier)
        return carrier.get(_HEADER, "")


@contextlib.contextmanager
def exporting(settings: Telemetry, machine: str, part: str) -> Generator[Sender]:
    """While it is open, spans of this process are sent as those of `part` (service, worker) of a machine."""
    sender = Sender(_exporter(settings))
    resource = Resource.create(
        {
            "service.name": "sweepid",
            "service.namespace": part,
            "service.instance.id": machine,
            "service.version": version("sweepid"),
        }
    )
    provider = TracerProvider(resource=resource, shutdown_on_exit=False)
    provider.add_span_processor(sender)
    TRACING.exporting = _Exporting(provider, sender)
    try:
        yield sender
    finally:
        TRACING.exporting = None
        provider.shutdown()


def _exporter(settings: Telemetry) -> OTLPSpanExporter:
    authority = None if settings.authority is None else str(settings.authority)
    return OTLPSpanExporter(f"{settings.endpoint}/v1/traces", certificate_file=authority, timeout=_ANSWER)
