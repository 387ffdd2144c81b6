"""A socketcand server (raw mode only): the bus as lines ``< ... >`` over TCP, shared by several clients.

    client: < open can0 >   < rawmode >   < send 201 2 f 0 >   < echo >
    server: < hi >  < ok >  < ok >        < frame 181 12.345678 3702 >   < error 040 12.345678 >

A frame sent by one client goes to `receive` and to the other clients; `send` reaches all of them. Sockets do not block
and are served by the owner's selector, so everything happens in the owner's thread.
"""

import re
import selectors
import socket
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import structlog

from simulator.canopen.node import Frame

_log = structlog.get_logger(__name__)
_LARGEST_BACKLOG = 1 << 20  # bytes a client may leave unread
_LARGEST_LINE = 256
_IDENTIFIER, _BYTE = re.compile("[0-9A-Fa-f]{1,8}"), re.compile("[0-9A-Fa-f]{1,2}")
_BUS_OFF = "040"  # SocketCAN's error class in the identifier of an error frame
_JOIN_DELAY = 0.02  # s; see _Client.joining


class SentFrame(NamedTuple):
    """A frame from a client, with 11-bit or (`extended`) 29-bit identifier."""

    frame: Frame
    extended: bool


def parse_send(identifier: str, length: str, data: Sequence[str]) -> SentFrame | None:
    """The words of a ``send``: hex identifier (extended: more than 3 digits), length, data bytes; None if it is no
    frame.
    """
    words = (identifier, length, *data)
    if not _IDENTIFIER.fullmatch(identifier) or not all(_BYTE.fullmatch(word) for word in words[1:]):
        return None
    number, extended = int(identifier, 16), len(identifier) > 3
    if len(data) > 8 or int(length, 16) != len(data) or number > (0x1FFFFFFF if extended else 0x7FF):
        return None
    return SentFrame(Frame(number, bytes(int(byte, 16) for byte in data)), extended)


class _Client:
    """One connection: ``hi`` sent, channel open, raw mode (on the bus)."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.received = bytearray()
        self.unsent = bytearray()
        self.opened = False
        self.raw = False
        self.joining = 0.0
        """Until then frames are buffered: python-can treats data directly after the last ``< ok >`` as an error."""


class SocketcandServer:
    """Serves `channel` on `host`:`port` (0: a free one). Raises OSError if the port is taken."""

    def __init__(
        self, selector: selectors.BaseSelector, host: str, port: int, channel: str, receive: Callable[[Frame], None]
    ) -> None:
        self._selector = selector
        self._channel = channel
        self._receive = receive
        self._clients: list[_Client] = []
        self._off = False
        self._listener = socket.create_server((host, port))
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        selector.register(self._listener, selectors.EVENT_READ, self._accept)

    def send(self, frame: Frame) -> None:
        """Send a frame to every client."""
        if not self._off:
            self._broadcast(frame, None)

    def switch_off(self, *, off: bool) -> None:
        """Bus-off: sends an error frame, then no frame passes in either direction until it is switched on."""
        if off and not self._off:
            self._tell(f"< error {_BUS_OFF} {time.time():.6f} >", None)
        self._off = off

    def close(self) -> None:
        """Disconnect every client and close the port."""
        for client in list(self._clients):
            self._drop(client, "server closes")
        self._selector.unregister(self._listener)
        self._listener.close()

    def due(self, now: float) -> float:
        """Seconds until buffered frames must be sent; infinity if there are none."""
        return max(min((c.joining for c in self._clients if c.joining), default=float("inf")) - now, 0.0)

    def run(self, now: float) -> None:
        """Send buffered frames."""
        for client in list(self._clients):
            if client.joining and now >= client.joining:
                self._join(client)

    def _accept(self, _: int) -> None:
        connection, address = self._listener.accept()
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client = _Client(connection)
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, partial(self._serve, client))
        _log.info("client connected", address=address)
        self._write(client, b"< hi >")

    def _serve(self, client: _Client, mask: int) -> None:
        if mask & selectors.EVENT_WRITE:
            self._flush(client)
        if mask & selectors.EVENT_READ and client in self._clients:
            self._read(client)

    def _read(self, client: _Client) -> None:
        try:
            data = client.connection.recv(65536)
        except BlockingIOError:
            return
        except OSError as error:
            self._drop(client, str(error))
            return
        if not data:
            self._drop(client, "closed by the client")
            return
        client.received += data
        *lines, rest = client.received.split(b">")
        client.received = bytearray(rest)
        if len(rest) > _LARGEST_LINE:
            self._drop(client, "not the socketcand protocol")
            return
        for line in lines:
            self._command(client, line.decode("ascii", "replace").replace("<", "", 1).split())

    def _command(self, client: _Client, words: list[str]) -> None:
        if client not in self._clients:
            return
        match words:
            case ["open", channel] if channel == self._channel:
                client.opened = True
                self._write(client, b"< ok >")
            case ["open", channel]:
                self._write(client, b"< error no channel " + channel.encode("ascii", "replace") + b" here >")
            case ["rawmode"] if client.opened:
                client.raw = True
                client.joining = time.monotonic() + _JOIN_DELAY
                self._transmit(client, b"< ok >")
            case ["echo"]:
                self._write(client, b"< echo >")
            case ["send", identifier, length, *data] if client.raw:
                if client.joining:
                    self._join(client)
                self._take(client, identifier, length, data)
            case _:
                self._write(client, b"< error unknown command >")

    def _take(self, client: _Client, identifier: str, length: str, data: list[str]) -> None:
        sent = parse_send(identifier, length, data)
        if sent is None:
            self._write(client, b"< error could not parse frame >")
        elif not self._off:
            self._broadcast(sent.frame, client, extended=sent.extended)
            if not sent.extended:
                self._receive(sent.frame)

    def _broadcast(self, frame: Frame, sender: _Client | None, *, extended: bool = False) -> None:
        width = 8 if extended else 3
        self._tell(f"< frame {frame.id:0{width}X} {time.time():.6f} {frame.data.hex().upper()} >", sender)

    def _tell(self, line: str, sender: _Client | None) -> None:
        for client in list(self._clients):
            if client.raw and client is not sender:
                self._write(client, line.encode())

    def _join(self, client: _Client) -> None:
        client.joining = 0.0
        self._flush(client)

    def _write(self, client: _Client, data: bytes) -> None:
        if client.unsent or client.joining:
            client.unsent += data
            if len(client.unsent) > _LARGEST_BACKLOG:
                self._drop(client, "does not read")
        else:
            self._transmit(client, data)

    def _flush(self, client: _Client) -> None:
        data, client.unsent = bytes(client.unsent), bytearray()
        if data:
            self._transmit(client, data)
        if client in self._clients and not client.unsent:
            self._listen(client, selectors.EVENT_READ)

    def _transmit(self, client: _Client, data: bytes) -> None:
        try:
            sent = client.connection.send(data)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            self._drop(client, str(error))
            return
        if sent < len(data):
            client.unsent += data[sent:]
            self._listen(client, selectors.EVENT_READ | selectors.EVENT_WRITE)

    def _listen(self, client: _Client, events: int) -> None:
        self._selector.modify(client.connection, events, partial(self._serve, client))

    def _drop(self, client: _Client, reason: str) -> None:
        if client in self._clients:
            self._clients.remove(client)
            self._selector.unregister(client.connection)
            client.connection.close()
            _log.info("client dropped", reason=reason)
