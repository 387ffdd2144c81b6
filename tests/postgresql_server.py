"""A PostgreSQL server of this computer's package, on a free port of loopback, in a folder of its own."""

import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path

import psycopg

from tests.ports import free_port
from tests.programs import path_of, require

PASSWORD = "not-for-logs-7731"
USER = "cell"
_PATIENCE = 180.0  # s
_UNPRIVILEGED = "postgres"  # the server refuses to run as root


class PostgresqlServer:
    """Stopped, killed and started again by tests; asks for a password."""

    def __init__(self, binaries: Path, folder: Path, durable: bool) -> None:
        self._binaries, self._data = binaries, folder / "data"
        self._more = [] if durable else ["-c", "fsync=off"]
        self.password_file = folder / "password"
        self.password_file.write_text(PASSWORD + "\n", "utf-8")
        self._numbers = count(1)
        self._port = free_port()
        if os.geteuid() == 0:
            for path in (folder, self.password_file):
                shutil.chown(path, _UNPRIVILEGED, _UNPRIVILEGED)
        self.passfile = folder / "pgpass"
        self.passfile.touch(0o600)
        self.passfile.write_text(f"127.0.0.1:{self._port}:*:{USER}:{PASSWORD}\n", "utf-8")
        self._run("initdb", "-D", str(self._data), "-U", USER, f"--pwfile={self.password_file}", *_FORM)
        self.process: subprocess.Popen[bytes] | None = None

    def url(self, database: str) -> str:
        return f"postgresql+psycopg://{USER}@127.0.0.1:{self._port}/{database}"

    def new_database(self) -> str:
        """The URL of an empty one."""
        name = f"cell_{next(self._numbers)}"
        with self._connected() as connection:
            connection.execute(f"CREATE DATABASE {name}".encode())
        return self.url(name)

    def start(self) -> None:
        """Returns when it lets clients in."""
        deadline = time.monotonic() + _PATIENCE
        self._launch()
        while True:
            with suppress(psycopg.OperationalError), self._connected():
                return
            if time.monotonic() > deadline:
                raise TimeoutError("the server of PostgreSQL does not start")
            time.sleep(0.05)
            if self.process is None or self.process.poll() is not None:  # what a killed one had started still ends
                self._launch()

    def _launch(self) -> None:
        words = ["-D", str(self._data), "-p", str(self._port), "-h", "127.0.0.1", "-k", str(self._data), *self._more]
        self.process = subprocess.Popen(
            [*_as_unprivileged(), str(self._binaries / "postgres"), *words],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd="/",
        )

    def stop(self) -> None:
        """At once, whoever is connected."""
        self._end(signal.SIGINT)

    def kill(self) -> None:
        """SIGKILL, as a power cut does it; those it had started end by themselves."""
        self._end(signal.SIGKILL)

    @contextmanager
    def _connected(self) -> Iterator[psycopg.Connection]:
        with psycopg.connect(
            host="127.0.0.1", port=self._port, user=USER, password=PASSWORD, dbname="postgres", autocommit=True
        ) as connection:
            yield connection

    def drop(self) -> None:
        """End it without a checkpoint: its folder goes."""
        self._end(signal.SIGQUIT)

    def _end(self, how: signal.Signals) -> None:
        if self.process is not None:
            self.process.send_signal(how)
            self.process.wait(_PATIENCE)
            self.process = None

    def _run(self, name: str, *arguments: str) -> None:
        command = [*_as_unprivileged(), str(self._binaries / name), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, timeout=_PATIENCE, check=False, cwd="/")
        assert done.returncode == 0, done.stderr


_FORM = ("-E", "UTF8", "--locale=C.UTF-8", "--auth=scram-sha-256", "--no-sync")


def _as_unprivileged() -> list[str]:
    if os.geteuid() != 0:
        return []
    return ["setpriv", f"--reuid={_UNPRIVILEGED}", f"--regid={_UNPRIVILEGED}", "--clear-groups", "--"]


@contextmanager
def running_server(durable: bool = True) -> Iterator[PostgresqlServer]:
    """`durable`: what is committed outlives a power cut, which costs time.

    The test is skipped where PostgreSQL is not installed.
    """
    require("initdb", "setpriv")
    found = path_of("initdb")
    assert found is not None
    # not in pytest's folders, which are closed to other users
    with tempfile.TemporaryDirectory(prefix="sweepid-postgresql-") as name:
        server = PostgresqlServer(found.parent, Path(name), durable)
        server.start()
        try:
            yield server
        finally:
            server.drop()
