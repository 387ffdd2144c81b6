"""An MQTT broker and a subscriber that are not ours (Debian's mosquitto and mosquitto_sub), on loopback."""

import json
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from tests.ports import free_port
from tests.programs import path_of, require

PATIENCE = 60.0  # s


class Message(NamedTuple):
    """`retained`: it was there before the subscriber came."""

    topic: str
    retained: bool
    content: str

    @property
    def json(self) -> Any:
        return json.loads(self.content)


@dataclass(frozen=True)
class Secured:
    """`certificate` and `key` of the broker, PEM; who signed it; name and password that it wants."""

    certificate: Path
    key: Path
    authority: Path
    user: str
    password: str


class Mosquitto:
    """Stopped and started again by tests, on one port. It keeps nothing."""

    def __init__(self, folder: Path, secured: Secured | None = None) -> None:
        require("mosquitto", "mosquitto_sub")
        self.port = free_port()
        self._secured, self._configuration = secured, folder / "mosquitto.conf"
        lines = [f"listener {self.port} 127.0.0.1", "persistence false"]
        if secured is None:
            lines.append("allow_anonymous true")
        else:
            passwords = folder / "passwords"
            command = ["mosquitto_passwd", "-b", "-c", str(passwords), secured.user, secured.password]
            subprocess.run(command, check=True, capture_output=True, timeout=PATIENCE)
            for path in (passwords, secured.key, secured.certificate, folder):
                path.chmod(0o755 if path.is_dir() else 0o644)  # the broker gives up root
            lines += [f"password_file {passwords}", f"certfile {secured.certificate}", f"keyfile {secured.key}"]
            lines += ["allow_anonymous false"]
        lines.append("user root")
        self._configuration.write_text("\n".join(lines) + "\n", "utf-8")
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        command = [str(path_of("mosquitto")), "-c", str(self._configuration)]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        began = time.monotonic()
        while True:
            try:
                socket.create_connection(("127.0.0.1", self.port), 1).close()
                return
            except OSError:
                if self._process.poll() is not None or time.monotonic() - began > PATIENCE:
                    raise
                time.sleep(0.05)

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    @contextmanager
    def subscribed(self, topic: str = "#") -> Iterator["Subscriber"]:
        more: list[str] = []
        if self._secured is not None:
            more = ["--cafile", str(self._secured.authority), "-u", self._secured.user, "-P", self._secured.password]
        command = ["mosquitto_sub", "-h", "localhost" if more else "127.0.0.1", "-p", str(self.port), "-t", topic]
        command += ["-q", "1", "-F", "%t\t%r\t%p", *more]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            try:
                yield Subscriber(process)
            finally:
                process.terminate()


class Subscriber:
    """What it got, in order."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process
        self.messages: list[Message] = []
        threading.Thread(target=self._read, daemon=True, name="subscriber").start()

    def of(self, topic: str) -> list[Message]:
        """Those whose topic ends like this."""
        return [message for message in tuple(self.messages) if message.topic.endswith(topic)]

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            topic, retained, content = line.rstrip("\n").split("\t", 2)
            self.messages.append(Message(topic, retained == "1", content))


@contextmanager
def broker(folder: Path, secured: Secured | None = None) -> Iterator[Mosquitto]:
    """It runs."""
    found = Mosquitto(folder, secured)
    found.start()
    try:
        yield found
    finally:
        found.stop()
