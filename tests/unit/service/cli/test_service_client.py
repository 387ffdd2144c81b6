"""The client against a real HTTP server that breaks the connection."""

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import islice
from urllib.parse import parse_qs, urlsplit

import pytest

from service import BadInput
from service.web.client import ServiceClient, ServiceProblem


class Handler(BaseHTTPRequestHandler):
    """Sends two events a connection, then breaks it off; refuses every POST."""

    def do_GET(self) -> None:
        query = parse_qs(urlsplit(self.path).query)
        after = int(query["after"][0])
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.end_headers()
        self.wfile.write(b": connected\n\n")
        for number in (after + 1, after + 2):
            document = json.dumps({"id": number, "kind": "sweep"})
            self.wfile.write(f"event: sweep\ndata: {document}\nid: {number}\n\n".encode())

    def do_POST(self) -> None:
        status = 422 if self.path.endswith("/robots") else 409
        problem = {"detail": "x: too large", "errors": [{"pointer": "#/x", "reason": "too large"}]}
        content = json.dumps(problem).encode()
        self.rfile.read(int(self.headers.get("Content-Length", 0)))
        self.send_response(status)
        self.send_header("Content-Type", "application/problem+json")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Quiet."""


@pytest.fixture
def url() -> Iterator[str]:
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = False
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}"
        finally:
            server.shutdown()
            thread.join()


@pytest.mark.slow
def test_events_go_on_after_the_last_one_seen_when_the_connection_breaks(url: str) -> None:
    with ServiceClient(url) as client:
        events = client.events(campaign_id=1, after=10)
        assert [event["id"] for event in islice(events, 5)] == [11, 12, 13, 14, 15]


def test_a_refused_input_is_bad_input_and_other_refusals_are_problems(url: str) -> None:
    with ServiceClient(url) as client:
        with pytest.raises(BadInput, match="#/x: too large"):
            client.add_robot({}, "")
        with pytest.raises(ServiceProblem) as refused:
            client.start(1)
    assert refused.value.status == 409
