"""The control port: fault injection while the virtual machine runs, JSON lines over TCP, one reply per line."""

import json
import selectors
import socket
from functools import partial

from simulator.fault_orders import AnyCabinet, Bus, Plant, carry_out

_LARGEST_LINE = 65536


class ControlServer:
    """Serves orders on `host`:`port` (0: a free one) through the owner's selector, in the owner's thread."""

    def __init__(
        self, selector: selectors.BaseSelector, host: str, port: int, cabinet: AnyCabinet, bus: Bus | None = None
    ) -> None:
        self._selector = selector
        self._plant = Plant(cabinet, bus)
        self._clients: dict[socket.socket, bytearray] = {}
        self._listener = socket.create_server((host, port))
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        selector.register(self._listener, selectors.EVENT_READ, self._accept)

    def close(self) -> None:
        """Disconnect every client and close the port."""
        for client in list(self._clients):
            self._drop(client)
        self._selector.unregister(self._listener)
        self._listener.close()

    def _accept(self, _: int) -> None:
        client, _address = self._listener.accept()
        client.settimeout(1.0)  # for replies; data is read only when available
        self._clients[client] = bytearray()
        self._selector.register(client, selectors.EVENT_READ, partial(self._serve, client))

    def _serve(self, client: socket.socket, _: int) -> None:
        try:
            data = client.recv(_LARGEST_LINE)
            received = self._clients[client]
            received += data
            *lines, rest = received.split(b"\n")
            self._clients[client] = bytearray(rest)
            for line in lines:
                client.sendall(json.dumps(carry_out(self._plant, bytes(line))).encode() + b"\n")
        except OSError:
            data = b""
        if not data or len(self._clients[client]) > _LARGEST_LINE:
            self._drop(client)

    def _drop(self, client: socket.socket) -> None:
        del self._clients[client]
        self._selector.unregister(client)
        client.close()
