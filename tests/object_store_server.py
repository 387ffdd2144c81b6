"""An S3 server that is not ours (moto) in a process on loopback, and a wire to it that can be cut or held."""

import os
import re
import select
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import httpx

from tests.ports import free_port

BUCKET = "cell"
_PATIENCE = 60.0  # s
_SIGNED = {"Authorization": "AWS4-HMAC-SHA256 Credential=test/20260101/us-east-1/s3/aws4_request"}  # moto asks no more


class S3Server:
    """Looked at and edited by plain HTTP."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.http = httpx.Client(base_url=f"http://127.0.0.1:{port}", headers=_SIGNED, timeout=60)

    @property
    def endpoint(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def reset(self) -> None:
        """Nothing but the empty bucket."""
        self.http.post("/moto-api/reset").raise_for_status()
        self.http.put(f"/{BUCKET}").raise_for_status()

    def keys(self) -> list[str]:
        return re.findall("<Key>(.*?)</Key>", self.http.get(f"/{BUCKET}", params={"list-type": 2}).text)

    def read(self, key: str) -> bytes:
        return self.http.get(f"/{BUCKET}/{key}").raise_for_status().content

    def changed_at(self, key: str) -> str:
        return self.http.head(f"/{BUCKET}/{key}").raise_for_status().headers["Last-Modified"]

    def write(self, key: str, content: bytes) -> None:
        self.http.put(f"/{BUCKET}/{key}", content=content).raise_for_status()

    def remove(self, key: str) -> None:
        self.http.delete(f"/{BUCKET}/{key}").raise_for_status()


@contextmanager
def running_s3() -> Iterator[S3Server]:
    """The server, with its bucket."""
    port = free_port()
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    with tempfile.TemporaryFile() as words:
        process = subprocess.Popen(command, stdout=words, stderr=words)
        server = S3Server(port)
        try:
            deadline = time.monotonic() + _PATIENCE
            while True:
                with suppress(httpx.TransportError):
                    server.reset()
                    break
                assert process.poll() is None, "moto's server ended"
                assert time.monotonic() < deadline, "moto's server does not start"
                time.sleep(0.05)
            yield server
        finally:
            server.http.close()
            process.kill()
            process.wait(_PATIENCE)


class Wire:
    """A port that leads to another one while it is whole. `held` is set when so many bytes of a client were let by."""

    def __init__(self, to: int) -> None:
        self.port = free_port()
        self._to = to
        self._let_by: int | None = None
        self.held = threading.Event()
        self._ended = threading.Event()
        self._listener: socket.socket | None = None
        self._threads: list[threading.Thread] = []

    @property
    def endpoint(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def mend(self) -> None:
        """Clients get through."""
        self._ended.clear()
        self._listener = socket.create_server(("127.0.0.1", self.port))
        self._begin(self._accept, self._listener)

    def hold_after(self, sent: int | None) -> None:
        """Of each connection to come, only so many bytes of what the client says get through; None: all."""
        self.held.clear()
        self._let_by = sent

    def cut(self) -> None:
        """All connections end, new ones are refused."""
        self._ended.set()
        for thread in self._threads:
            thread.join(_PATIENCE)
        self._threads.clear()
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def _begin(self, work: object, *arguments: object) -> None:
        thread = threading.Thread(target=work, args=arguments)  # type: ignore[arg-type]
        thread.start()
        self._threads.append(thread)

    def _accept(self, listener: socket.socket) -> None:
        while not self._ended.is_set():
            if select.select([listener], [], [], 0.02)[0]:
                client, _ = listener.accept()
                self._begin(self._carry, client)

    def _carry(self, client: socket.socket) -> None:
        left = self._let_by
        with client, socket.create_connection(("127.0.0.1", self._to)) as server:
            while not self._ended.is_set():
                sources = [server] if left == 0 else [client, server]
                for source in select.select(sources, [], [], 0.02)[0]:
                    try:
                        data = source.recv(2**16 if source is server or left is None else min(left, 2**16))
                    except OSError:
                        return
                    if not data:
                        return
                    (client if source is server else server).sendall(data)
                    if source is client and left is not None:
                        left -= len(data)
                        if left == 0:
                            self.held.set()


@contextmanager
def wire_to(server: S3Server) -> Iterator[Wire]:
    wire = Wire(server.port)
    wire.mend()
    try:
        yield wire
    finally:
        wire.cut()


def key_file(folder: Path) -> Path:
    """As AWS's own programs write it."""
    path = folder / "credentials"
    path.touch(0o600)
    path.write_text("[default]\naws_access_key_id = test\naws_secret_access_key = not-for-logs-2231\n", "utf-8")
    return path


def without_keys() -> dict[str, str]:
    """The environment without anybody's keys."""
    return {name: value for name, value in os.environ.items() if not name.startswith("AWS_")}
