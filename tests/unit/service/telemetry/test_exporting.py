"""Spans reach a collector; one that is away, slow or refuses costs spans, which are counted, and nobody's time."""

import asyncio
import socket
import time

import pytest

from service import BadInput
from service.process.settings import Telemetry
from service.process.span_export import SpanExport
from service.process.telemetry import TRACING, traced
from tests.otlp_collector import collecting


async def test_spans_nest_across_tasks_threads_and_processes() -> None:
    with collecting() as collector:
        with traced(Telemetry(endpoint=collector.endpoint), "cell 7"):

            async def later() -> str:
                with TRACING.span("task"):
                    return await asyncio.to_thread(in_thread)

            def in_thread() -> str:
                with TRACING.span("thread"):
                    return TRACING.traceparent

            with TRACING.span("request", campaign=3):
                task = asyncio.create_task(later(), name="later")
            elsewhere = await task  # after the request was answered
            with TRACING.span("process", elsewhere):
                pass
            with pytest.raises(ValueError, match="planted"), TRACING.span("fails"):
                raise ValueError("planted")
        spans = {span.name: span for span in collector.spans}
    assert [spans[name].parent for name in ("request", "task", "thread", "process", "fails")] == [
        "",
        spans["request"].span,
        spans["task"].span,
        spans["thread"].span,
        "",
    ]
    assert len({spans[name].trace for name in ("request", "task", "thread", "process")}) == 1
    assert spans["fails"].trace != spans["request"].trace
    assert [name for name, span in spans.items() if span.failed] == ["fails"]
    assert spans["request"].attributes == {"sweepid.campaign": 3}
    assert {(span.machine, span.part) for span in spans.values()} == {("cell 7", "service")}


def test_without_a_collector_spans_are_dropped_and_counted() -> None:
    with socket.create_server(("127.0.0.1", 0)) as deaf:  # takes connections and never answers
        endpoint = f"http://127.0.0.1:{deaf.getsockname()[1]}"
        export = SpanExport(Telemetry(endpoint=endpoint), "cell 7", "service", waiting=10, answer=0.5)
        began = time.monotonic()
        for _ in range(1000):
            with export.span("sweep", "", {}):
                pass
        assert time.monotonic() - began < 5.0  # s; none waited for an answer
        export.close()
        assert export.dropped == 1000


def test_nothing_is_made_where_nothing_is_wanted() -> None:
    assert TRACING.export is None
    with TRACING.span("sweep", campaign=1) as note:
        note("a", 1)
        assert TRACING.traceparent == ""
    assert TRACING.dropped is None


def test_beyond_this_computer_it_is_encrypted() -> None:
    with pytest.raises(BadInput, match=r"otel.endpoint: http://collector:4318 is not encrypted"):
        Telemetry(endpoint="http://collector:4318").checked(trusted_network=False)
    Telemetry(endpoint="http://collector:4318").checked(trusted_network=True)
    Telemetry(endpoint="https://collector:4318").checked(trusted_network=False)
