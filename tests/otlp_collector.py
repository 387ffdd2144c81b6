"""A collector of traces on loopback: what comes is decoded by OpenTelemetry's own protocol package."""

import gzip
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, HTTPServer

from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import (
    ExportTraceServiceRequest,
    ExportTraceServiceResponse,
)


@dataclass(frozen=True)
class Received:
    """`part`: which process sent it. Times in s."""

    name: str
    trace: str
    span: str
    parent: str
    part: str
    machine: str
    failed: bool
    begin: float
    end: float
    attributes: dict[str, str | int] = field(default_factory=dict)


class Collector:
    """Answers with the status that it is told to."""

    def __init__(self, port: int = 0) -> None:
        self.spans: list[Received] = []
        self.status = 200
        collector = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                if self.headers.get("Content-Encoding") == "gzip":
                    body = gzip.decompress(body)
                if collector.status == 200 and self.path == "/v1/traces":
                    collector.spans += decoded(body)
                answer = ExportTraceServiceResponse().SerializeToString()
                self.send_response(collector.status)
                self.send_header("Content-Type", "application/x-protobuf")
                self.send_header("Content-Length", str(len(answer)))
                self.end_headers()
                self.wfile.write(answer)

            def log_message(self, format: str, *args: object) -> None:
                pass

        self._server = HTTPServer(("127.0.0.1", port), Handler)
        self.endpoint = f"http://127.0.0.1:{self._server.server_address[1]}"

    def serve(self) -> None:
        self._server.serve_forever(0.05)

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()

    def named(self, name: str) -> list[Received]:
        return [span for span in tuple(self.spans) if span.name == name]


def decoded(body: bytes) -> Iterator[Received]:
    for resource in ExportTraceServiceRequest.FromString(body).resource_spans:
        about = {each.key: each.value.string_value for each in resource.resource.attributes}
        for scope in resource.scope_spans:
            for span in scope.spans:
                yield Received(
                    name=span.name,
                    trace=span.trace_id.hex(),
                    span=span.span_id.hex(),
                    parent=span.parent_span_id.hex(),
                    part=about["service.namespace"],
                    machine=about["service.instance.id"],
                    failed=span.status.code == 2,
                    begin=span.start_time_unix_nano * 1e-9,
                    end=span.end_time_unix_nano * 1e-9,
                    attributes={each.key: each.value.string_value or each.value.int_value for each in span.attributes},
                )


@contextmanager
def collecting(port: int = 0) -> Iterator[Collector]:
    collector = Collector(port)
    thread = threading.Thread(target=collector.serve, name="collector", daemon=True)
    thread.start()
    try:
        yield collector
    finally:
        collector.close()
        thread.join()
