"""Traces for OpenTelemetry: `spans` is used everywhere and imports no library, `exporting` needs the extra `otel`."""

from contextlib import AbstractContextManager, nullcontext

from service.process.settings.telemetry import Telemetry


def traced(traces: Telemetry | None, machine: str) -> AbstractContextManager[object]:
    """While it is open, spans of the service are sent. The library is only imported if traces are enabled."""
    if traces is None:
        return nullcontext()
    from service.process.telemetry.exporting import exporting

    return exporting(traces, machine, "service")
