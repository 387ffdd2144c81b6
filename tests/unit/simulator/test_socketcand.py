"""The socketcand server's own parser: any words, any bytes from a client."""

import selectors
import socket
import time
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from simulator.canopen.line import SentFrame, SocketcandServer, parse_send
from simulator.canopen.pdo import Frame

pytestmark = pytest.mark.slow

LOOSE = settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@given(number=st.integers(0, 0x7FF), data=st.binary(max_size=8))
def test_frames_come_through_as_they_were_sent(number: int, data: bytes) -> None:
    words = [f"{byte:x}" for byte in data]
    assert parse_send(f"{number:03X}", f"{len(data):x}", words) == SentFrame(Frame(number, data), extended=False)
    assert parse_send(f"{number:08X}", f"{len(data):x}", words) == SentFrame(Frame(number, data), extended=True)


@pytest.mark.parametrize(
    "words",
    [
        ("800", "0"),
        ("20000000", "0"),
        ("123", "1"),
        ("123", "1", "100"),
        ("-1", "0"),
        ("1_0", "0"),
        ("0x1", "0"),
        ("123", "9", *["0"] * 9),
        ("", "0"),
        ("123", "-0"),
    ],
)
def test_what_is_no_frame_is_refused(words: tuple[str, ...]) -> None:
    assert parse_send(words[0], words[1], words[2:]) is None


class Wire:
    """A server served by hand, and one client of it."""

    def __init__(self) -> None:
        self.selector = selectors.SelectSelector()
        self.received: list[Frame] = []
        self.server = SocketcandServer(self.selector, "127.0.0.1", 0, "can0", self.received.append)
        self.client: socket.socket | None = None

    def connect(self) -> socket.socket:
        if self.client is not None:
            self.client.close()
            self.turn(2)
        self.client = socket.create_connection(("127.0.0.1", self.server.port), timeout=10)
        self.turn(1)
        return self.client

    def turn(self, events: int) -> None:
        """Serve what is pending, waiting for the first of it."""
        timeout = 5.0
        for _ in range(events):
            for key, mask in self.selector.select(timeout):
                key.data(mask)
            self.server.run(time.monotonic())
            timeout = 0.01


@pytest.fixture
def wire() -> Iterator[Wire]:
    wire = Wire()
    yield wire
    if wire.client is not None:
        wire.client.close()
    wire.server.close()
    wire.selector.close()


def lines() -> st.SearchStrategy[bytes]:
    words = st.sampled_from([b"open", b"can0", b"rawmode", b"send", b"echo", b"123", b"1", b"ff", b"<", b"\xff"])
    line = st.lists(words, max_size=6).map(lambda parts: b"< " + b" ".join(parts) + b" >")
    return line | st.binary(max_size=400)


@pytest.mark.slow
@LOOSE
@given(chunks=st.lists(lines(), min_size=1, max_size=6))
def test_any_bytes_from_a_client(wire: Wire, chunks: list[bytes]) -> None:
    client = wire.connect()
    wire.received.clear()
    whole = b"".join(chunks)
    client.sendall(whole)
    wire.turn(3)
    if not (b"open can0" in whole and b"rawmode" in whole):
        assert wire.received == []
    assert all(len(frame.data) <= 8 and frame.id <= 0x7FF for frame in wire.received)


def test_bus_off_keeps_every_frame_back(wire: Wire) -> None:
    client = wire.connect()
    client.sendall(b"< open can0 >< rawmode >< send 123 1 ff >")
    wire.turn(2)
    assert wire.received == [Frame(0x123, b"\xff")]
    wire.server.switch_off(off=True)
    wire.server.switch_off(off=True)
    wire.server.send(Frame(0x181, b"\1"))
    client.sendall(b"< send 124 0 >")
    wire.turn(2)
    wire.server.switch_off(off=False)
    wire.server.send(Frame(0x182, b"\2"))
    wire.server.run(time.monotonic())
    data = b""
    while b"182" not in data:
        data += client.recv(4096)
    assert data.count(b"< error 040 ") == 1
    assert b"frame 181" not in data
    assert wire.received == [Frame(0x123, b"\xff")]
