"""The port of the stop process: minimal HTTP, one thread, one route. Every client may stop the machine.

A stop is executed when its first line has arrived, without waiting for headers or body. Its answer comes later, from
another thread; meanwhile this thread serves all others. A connection without data is closed after its time limit, or
when others need its place. With a certificate it also accepts TLS, for clients that begin with it: a page loaded by
HTTPS cannot send elsewhere.
"""

import json
import queue
import selectors
import socket
import ssl
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from urllib.parse import parse_qs, urlsplit

from service.machine.stop_process.bus import StopOutcome

LONGEST_WAIT = 1.0  # s that a stop waits for its confirmation; the answer comes within 1.2 s

Answer = tuple[int, dict[str, object]]  # HTTP status, JSON


@dataclass(frozen=True)
class Request:
    """Origin and reason of a stop. `press` identifies one press of a button that arrives by two ways.

    `wait`: s for the confirmation; 0: the answer is that the stop was sent.
    """

    by: str
    why: str
    press: str
    address: str
    wait: float = LONGEST_WAIT

    def words(self) -> dict[str, str]:
        """What the service is told."""
        words = asdict(self)
        del words["wait"]
        return words


def waiting_time(word: object) -> float:
    """The parameter `wait`, s from 0 to `LONGEST_WAIT`. Whatever else it is: a stop is not refused."""
    try:
        wanted = float(str(word))
    except ValueError:
        return LONGEST_WAIT
    return max(0.0, wanted) if wanted < LONGEST_WAIT else LONGEST_WAIT  # also if it is not a number


def not_confirmed(sent: bool, within: float, unconfirmed: Mapping[str, str]) -> str:
    """The sentence for a person."""
    what = f"stop sent, not confirmed within {within:g} s" if sent else "stop not sent"
    reasons = "; ".join(f"{joint}: {reason}" for joint, reason in unconfirmed.items())
    return f"{what}{': ' if reasons else ''}{reasons}; use the emergency stop"


def answer_to(wanted: Request, sent: StopOutcome, confirmed: StopOutcome | None) -> Answer:
    """`confirmed`: None if it is not waited for. 200 only if every axis reports standstill without energy."""
    if confirmed is None and sent.good:
        doubts = {joint: doubt for joint, doubt in sent.joints.items() if doubt}
        return 202, {"sent": sent.good, "confirmed": (), "unconfirmed": doubts}
    reported = sent if confirmed is None else confirmed
    stands = () if confirmed is None else confirmed.good
    unconfirmed = {joint: doubt for joint, doubt in reported.joints.items() if doubt}
    # a bus that was opened meanwhile got the stop at once
    told = sent.good or (() if confirmed is None or confirmed.trouble else tuple(confirmed.joints))
    facts: dict[str, object] = {"sent": told, "confirmed": stands, "unconfirmed": unconfirmed}
    if stands and not unconfirmed:
        return 200, facts
    trouble = unconfirmed or {"stop process": reported.trouble or "no drive is known"}
    return 503, {
        "type": "urn:sweepid:problem:stop-not-confirmed",
        "title": "Service Unavailable",
        "status": 503,
        "detail": not_confirmed(bool(told), wanted.wait, trouble),
        **facts,
    }


class Secured:
    """TLS of one connection, in memory: the socket stays plain, and nothing blocks."""

    def __init__(self, context: ssl.SSLContext) -> None:
        self._coming, self._going = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._coming, self._going, server_side=True)

    def read(self, data: bytes) -> tuple[bytes, bytes]:
        """Decrypted bytes, and bytes to send now during the handshake. ssl.SSLError."""
        self._coming.write(data)
        said = bytearray()
        try:
            while piece := self._tls.read(65536):
                said += piece
        except (ssl.SSLWantReadError, ssl.SSLZeroReturnError):
            pass
        return bytes(said), self._going.read()

    def write(self, words: bytes) -> bytes:
        """The bytes encrypted for the wire. ssl.SSLError."""
        self._tls.write(words)
        return self._going.read()


BEAT = 0.25  # s between signs of life


Answered = Callable[[Answer], None]
"""Sends the answer; from any thread."""


@dataclass
class _Connection:
    socket: socket.socket
    address: str
    until: float
    received: bytearray = field(default_factory=bytearray)
    asked: bool = False  # its request has arrived
    answered: bool = False
    secured: Secured | None = None


class Listener:
    """Listens at `host`:`port` (0: any free one) from now on; OSError if that is not possible."""

    longest_line = 4096  # bytes of a request's first line
    most_connections = 256
    patience = 5.0  # s for a connection, from its start to its end

    def __init__(
        self,
        host: str,
        port: int,
        stop: Callable[[Request, Answered], None],
        status: Callable[[], Answer],
        tls: ssl.SSLContext | None = None,
        alive: Callable[[], None] = lambda: None,
    ) -> None:
        """`alive` is called every `BEAT` s while this thread serves."""
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._listener = socket.create_server((host, port), family=family, backlog=1024)
        self._listener.setblocking(False)
        self._stop, self._status, self._tls, self._alive = stop, status, tls, alive
        self._answers: queue.SimpleQueue[tuple[_Connection, Answer]] = queue.SimpleQueue()
        self._waking, self._woken = socket.socketpair()
        self._waking.setblocking(False)
        self._woken.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._connections: dict[socket.socket, _Connection] = {}  # oldest first
        self.port: int = self._listener.getsockname()[1]

    def serve(self) -> None:
        """Run forever."""
        beat = time.monotonic()
        while True:
            for key, _ in self._selector.select(BEAT):
                if key.fileobj is self._listener:
                    self._accept()
                elif key.fileobj is self._woken:
                    self._send_answers()
                elif (connection := self._connections.get(key.fileobj)) is not None:  # pyright: ignore[reportArgumentType]
                    self._read(connection)
            now = time.monotonic()
            if now >= beat:
                beat = now + BEAT
                self._alive()
            for connection in [each for each in self._connections.values() if each.until < now]:
                self._drop(connection)

    def close(self) -> None:
        """After `serve` has ended."""
        for connection in tuple(self._connections.values()):
            self._drop(connection)
        for each in (self._listener, self._waking, self._woken, self._selector):
            each.close()

    def _accept(self) -> None:
        try:
            accepted, address = self._listener.accept()
        except OSError:  # already closed, or no descriptor free
            return
        accepted.setblocking(False)
        connection = _Connection(accepted, str(address[0]), time.monotonic() + self.patience)
        self._connections[accepted] = connection
        self._selector.register(accepted, selectors.EVENT_READ)
        self._read(connection)  # most have already sent data
        if len(self._connections) > self.most_connections:
            least = self._least_needed(connection)
            if least.asked and not least.answered:
                self._answer(least, (503, {"detail": "too many stops at once: sent, not confirmed"}))
            self._drop(least)

    def _least_needed(self, newest: _Connection) -> _Connection:
        """The oldest one, if possible without a stop that waits for its confirmation. Never the newest, whose stop may
        be on its way; that of any other has been sent, or could have come.
        """
        others = [each for each in self._connections.values() if each is not newest]
        return next((each for each in others if each.answered or not each.asked), others[0])

    def _read(self, connection: _Connection) -> None:
        try:
            data = connection.socket.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data and connection.asked and not connection.answered:
            self._selector.unregister(connection.socket)  # it has only ended its own half
        elif not data:
            self._drop(connection)
        elif not connection.asked:
            try:
                connection.received += self._opened(connection, data)
            except OSError:  # includes the errors of ssl
                self._drop(connection)
                return
            line, found, _ = bytes(connection.received).partition(b"\r\n")
            if found or len(line) > self.longest_line:
                connection.asked = True
                self._take(connection, line.decode("latin-1"))

    def _opened(self, connection: _Connection, data: bytes) -> bytes:
        """The decrypted bytes."""
        begins = not connection.received and connection.secured is None
        if begins and self._tls is not None and data.startswith(b"\x16"):  # of TLS; no HTTP method begins with it
            connection.secured = Secured(self._tls)
        if connection.secured is None:
            return data
        said, reply = connection.secured.read(data)
        connection.socket.send(reply)  # its few kB always fit into the empty buffer of a new connection
        return said

    def _take(self, connection: _Connection, line: str) -> None:
        method, _, rest = line.partition(" ")
        try:
            url = urlsplit(rest.partition(" ")[0])
            asked = parse_qs(url.query)
        except ValueError:
            self._answer(connection, (400, {"detail": "not a request"}))
            return
        if url.path.rstrip("/") not in ("/stop", "/api/v1/stop"):
            self._answer(connection, (404, {"detail": "this port accepts only POST /stop"}))
        elif method == "POST":
            by, why, press, wait = (asked.get(name, [""])[0] for name in ("by", "why", "press", "wait"))
            words = (by[:100] or connection.address, why[:500] or "stop requested", press[:100], connection.address)
            self._stop(Request(*words, waiting_time(wait)), partial(self._answer_later, connection))
        elif method in ("GET", "HEAD"):
            self._answer(connection, self._status())
        else:
            self._answer(connection, (200 if method == "OPTIONS" else 405, {}))

    def _answer_later(self, connection: _Connection, answer: Answer) -> None:
        self._answers.put((connection, answer))
        with suppress(BlockingIOError):  # full: it is awake
            self._waking.send(b"w")

    def _send_answers(self) -> None:
        with suppress(BlockingIOError):
            self._woken.recv(4096)
        while not self._answers.empty():
            connection, answer = self._answers.get()
            if connection.socket in self._connections:
                self._answer(connection, answer)

    def _answer(self, connection: _Connection, answer: Answer) -> None:
        """Then read the remaining input: a connection closed with unread data would lose the answer."""
        connection.answered = True
        status, content = answer
        body = json.dumps(content).encode()
        kind = "application/json" if status < 400 else "application/problem+json"
        head = (
            f"HTTP/1.1 {status} {'OK' if status < 400 else 'Refused'}\r\nContent-Type: {kind}\r\n"
            "Access-Control-Allow-Origin: *\r\n"  # every page may stop
            "Access-Control-Allow-Methods: POST\r\nCache-Control: no-store\r\nConnection: close\r\n"
            f"Content-Length: {len(body)}\r\n\r\n"
        )
        with suppress(OSError):
            words = head.encode() + body
            connection.socket.send(words if connection.secured is None else connection.secured.write(words))
            connection.socket.shutdown(socket.SHUT_WR)

    def _drop(self, connection: _Connection) -> None:
        self._connections.pop(connection.socket, None)
        with suppress(KeyError, ValueError):
            self._selector.unregister(connection.socket)
        connection.socket.close()
