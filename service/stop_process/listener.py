"""The port of the stop process: minimal HTTP, one thread, one route. Every client may stop the machine.

A stop is executed when its first line has arrived, without waiting for headers or body. A connection without data is
closed after its time limit, or when others need its place. With a certificate it also accepts TLS, for clients that
begin with it: a page loaded by HTTPS cannot send elsewhere.
"""

import json
import selectors
import socket
import ssl
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from urllib.parse import parse_qs, urlsplit

from service.stop_process.tls import HANDSHAKE, Secured

PATHS = ("/stop", "/api/v1/stop")
LONGEST_LINE = 4096  # bytes of a request's first line
MOST_CONNECTIONS = 256
PATIENCE = 5.0  # s for a connection, from its start to its end
_ANY_ORIGIN = "Access-Control-Allow-Origin: *\r\n"  # every page may stop


@dataclass(frozen=True)
class Request:
    """Origin and reason of a stop. `press` identifies one press of a button that arrives by two ways."""

    by: str
    why: str
    press: str
    address: str


Answer = tuple[int, dict[str, object]]  # HTTP status, JSON


@dataclass
class _Connection:
    socket: socket.socket
    address: str
    until: float
    received: bytearray = field(default_factory=bytearray)
    answered: bool = False
    secured: Secured | None = None


class Listener:
    """Listens at `host`:`port` (0: any free one) from now on; OSError if that is not possible."""

    def __init__(
        self,
        host: str,
        port: int,
        stop: Callable[[Request], Answer],
        status: Callable[[], Answer],
        tls: ssl.SSLContext | None = None,
    ) -> None:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._listener = socket.create_server((host, port), family=family, backlog=1024)
        self._listener.setblocking(False)
        self._stop, self._status, self._tls = stop, status, tls
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._connections: dict[socket.socket, _Connection] = {}  # oldest first
        self.port: int = self._listener.getsockname()[1]

    def serve(self) -> None:
        """Run forever."""
        while True:
            for key, _ in self._selector.select(1.0):
                if key.fileobj is self._listener:
                    self._accept()
                elif (connection := self._connections.get(key.fileobj)) is not None:  # pyright: ignore[reportArgumentType]
                    self._read(connection)
            now = time.monotonic()
            for connection in [each for each in self._connections.values() if each.until < now]:
                self._drop(connection)

    def _accept(self) -> None:
        try:
            accepted, address = self._listener.accept()
        except OSError:  # already closed, or no descriptor free
            return
        accepted.setblocking(False)
        connection = _Connection(accepted, str(address[0]), time.monotonic() + PATIENCE)
        self._connections[accepted] = connection
        self._selector.register(accepted, selectors.EVENT_READ)
        self._read(connection)  # most have already sent data
        if len(self._connections) > MOST_CONNECTIONS:
            self._drop(next(iter(self._connections.values())))

    def _read(self, connection: _Connection) -> None:
        try:
            data = connection.socket.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(connection)
        elif not connection.answered:
            try:
                connection.received += self._opened(connection, data)
            except OSError:  # includes the errors of ssl
                self._drop(connection)
                return
            line, found, _ = bytes(connection.received).partition(b"\r\n")
            if found or len(line) > LONGEST_LINE:
                self._answer(connection, line.decode("latin-1"))

    def _opened(self, connection: _Connection, data: bytes) -> bytes:
        """The decrypted bytes."""
        begins = not connection.received and connection.secured is None
        if begins and self._tls is not None and data.startswith(HANDSHAKE):
            connection.secured = Secured(self._tls)
        if connection.secured is None:
            return data
        said, reply = connection.secured.read(data)
        connection.socket.send(reply)  # its few kB always fit into the empty buffer of a new connection
        return said

    def _answer(self, connection: _Connection, line: str) -> None:
        """Then read the remaining input: a connection closed with unread data would lose the answer."""
        connection.answered = True
        status, content = self._answer_to(line, connection.address)
        body = json.dumps(content).encode()
        kind = "application/json" if status < 400 else "application/problem+json"
        head = (
            f"HTTP/1.1 {status} {'OK' if status < 400 else 'Refused'}\r\nContent-Type: {kind}\r\n{_ANY_ORIGIN}"
            "Access-Control-Allow-Methods: POST\r\nCache-Control: no-store\r\nConnection: close\r\n"
            f"Content-Length: {len(body)}\r\n\r\n"
        )
        with suppress(OSError):
            words = head.encode() + body
            connection.socket.send(words if connection.secured is None else connection.secured.write(words))
            connection.socket.shutdown(socket.SHUT_WR)

    def _answer_to(self, line: str, address: str) -> Answer:
        method, _, rest = line.partition(" ")
        try:
            url = urlsplit(rest.partition(" ")[0])
            asked = parse_qs(url.query)
        except ValueError:
            return 400, {"detail": "not a request"}
        if url.path.rstrip("/") in PATHS:
            if method == "POST":
                by, why, press = (asked.get(name, [""])[0] for name in ("by", "why", "press"))
                return self._stop(Request(by[:100] or address, why[:500] or "stop requested", press[:100], address))
            return self._status() if method in ("GET", "HEAD") else (200 if method == "OPTIONS" else 405, {})
        return 404, {"detail": "this port accepts only POST /stop"}

    def _drop(self, connection: _Connection) -> None:
        self._connections.pop(connection.socket, None)
        with suppress(KeyError, ValueError):
            self._selector.unregister(connection.socket)
        connection.socket.close()
