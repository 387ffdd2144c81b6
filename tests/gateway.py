"""A gateway between hosts and a virtual machine that loses what one of them says, or everything."""

import selectors
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from enum import Enum


class Loss(Enum):
    """What does not pass."""

    NOTHING = "nothing"
    COMMANDS = "commands"  # heartbeats of the drives arrive
    ANSWERS = "answers"  # the drives hear
    BOTH = "frozen"  # the connections stay open
    GATEWAY = "gateway gone"  # and nobody can connect


class Gateway:
    """One thread copies between the clients at `port` and the machine at `target`."""

    def __init__(self, target: int) -> None:
        self.loss = Loss.NOTHING
        self._target = target
        self._selector = selectors.DefaultSelector()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._others: dict[socket.socket, tuple[socket.socket, bool]] = {}  # and whether it is a client
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="gateway")
        self._thread.start()

    def close(self) -> None:
        self._closing.set()
        self._thread.join()
        self._hang_up()
        self._selector.close()

    def _run(self) -> None:
        while not self._closing.is_set():
            for key, _ in self._selector.select(0.02):
                if key.fileobj is self._listener:
                    self._accept()
                elif isinstance(key.fileobj, socket.socket) and key.fileobj in self._others:
                    self._copy(key.fileobj)
            if self.loss is Loss.GATEWAY:
                self._hang_up()

    def _accept(self) -> None:
        client, _ = self._listener.accept()
        machine = socket.create_connection(("127.0.0.1", self._target))
        for one, other, is_client in ((client, machine, True), (machine, client, False)):
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._others[one] = other, is_client
            self._selector.register(one, selectors.EVENT_READ)

    def _copy(self, one: socket.socket) -> None:
        other, is_client = self._others[one]
        try:
            data = one.recv(65536)
            lost = {Loss.BOTH, Loss.COMMANDS if is_client else Loss.ANSWERS}
            if data and self.loss not in lost:
                other.sendall(data)
        except OSError:
            data = b""
        if not data:
            self._end(one, other)

    def _end(self, *ends: socket.socket) -> None:
        for one in ends:
            if self._others.pop(one, None) is not None:
                self._selector.unregister(one)
            one.close()

    def _hang_up(self) -> None:
        if self._listener.fileno() >= 0:
            with suppress(KeyError):
                self._selector.unregister(self._listener)
            self._listener.close()
        self._end(*tuple(self._others))


@contextmanager
def gateway(target: int) -> Iterator[Gateway]:
    between = Gateway(target)
    try:
        yield between
    finally:
        between.close()
