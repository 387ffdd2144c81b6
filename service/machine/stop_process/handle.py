"""The service's end of the stop process: starts it, requests a stop, receives stops, restarts it if it ends."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import structlog

from service import SweepidError
from service.machine.stop_process import END, ORDER, TAKEN_OVER

_log = structlog.get_logger(__name__)


Word = Callable[[str, str, str, str], None]


class StopNotStarted(SweepidError):
    """The stop process cannot listen at its port, or does not start."""


class StopProcess:
    """A context manager. `drive`: profile of the machine; `port` 0: any free port.

    `tls`: certificate and key, for clients that begin with TLS.
    """

    hung = 2.0  # s without a sign of life, which comes every `listener.BEAT`

    def __init__(self, drive: Path, host: str, port: int, tls: tuple[Path, Path] | None = None) -> None:
        self.port = port
        self._trouble = "not started yet"
        self._alive = time.monotonic()  # of the last sign of life
        self._drive, self._host = drive, host
        self._tls = [str(path) for path in tls or ()]
        self._reading, self._writing = os.pipe()  # one pipe for all processes: signals are always written to it
        os.set_blocking(self._writing, False)
        self._ended = ""
        self._closing = threading.Event()
        self._word: Word | None = None
        self._early: list[tuple[str, str, str, str]] = []  # stops before a listener was attached
        self._attaching = threading.Lock()
        self._watching = False  # signals are written to this process' pipe

    def __enter__(self) -> Self:
        """Returns when the process listens. StopNotStarted."""
        self._process = self._start()
        self._thread = threading.Thread(target=self._follow, name="stop-process", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._tell(END)
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._thread.join()
        if self._watching:
            signal.set_wakeup_fd(-1)  # the number of a closed descriptor is soon used for another file
        os.close(self._writing)
        os.close(self._reading)

    def watch_signals(self) -> None:
        """From now on a signal to this process is a stop, written by the interpreter before any Python code runs.

        Only in the main thread, and only if the wake-up descriptor is not in use; no effect on Windows.
        """
        if sys.platform != "win32":
            signal.set_wakeup_fd(self._writing, warn_on_full_buffer=False)
            self._watching = True

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def failed(self) -> str:
        """Why it cannot stop anything now: it has ended and is being restarted, or it hangs; "" if it works."""
        silent = time.monotonic() - self._alive
        if self._ended or silent <= self.hung:
            return self._ended
        return f"the stop process has not answered for {silent:.0f} s, limit {self.hung:g} s: restart the service"

    @property
    def trouble(self) -> str:
        """As `failed`, or why its connection to the drives is not open."""
        return self.failed or self._trouble

    def order(self) -> None:
        """Request the stop on the bus. From any thread; does not wait."""
        self._tell(ORDER)

    def taken_over(self) -> None:
        """The service handles the drives itself."""
        self._tell(TAKEN_OVER)

    def attach(self, word: Word | None) -> None:
        """`word` gets by, why, press and address of every stop from the process' port, in a separate thread."""
        with self._attaching:
            self._word, early = word, self._early
            if word is not None:
                self._early = []
                for each in early:
                    word(*each)

    # -- inside

    def _tell(self, word: bytes) -> None:
        try:
            os.write(self._writing, word)
        except OSError as error:
            _log.error("stop_process_not_told", reason=str(error))

    def _start(self) -> "subprocess.Popen[bytes]":
        words = [str(self._drive), self._host, str(self.port), *self._tls]
        command = [sys.executable, "-P", "-m", "service.machine.stop_process", *words]
        # in a session of its own: signals of the terminal are for the service, which forwards them
        process: subprocess.Popen[bytes] = subprocess.Popen(
            command, stdin=self._reading, stdout=subprocess.PIPE, start_new_session=True
        )
        first = self._read(process)
        if "port" not in first:
            process.wait()
            if process.stdout:
                process.stdout.close()
            raise StopNotStarted(str(first.get("error", "the stop process did not start; see the log")))
        self.port, self._trouble, self._ended = int(first["port"]), "not connected yet", ""
        self._alive = time.monotonic()
        return process

    def _follow(self) -> None:
        while True:
            while message := self._read(self._process):
                self._take(message)
            code = self._process.wait()
            if self._process.stdout:
                self._process.stdout.close()
            if self._closing.is_set():
                return
            self._ended = f"the stop process ended (code {code})"
            _log.error("stop_process_ended", code=code)
            while not self._closing.wait(1.0):
                with suppress(StopNotStarted):
                    self._process = self._start()
                    break
            else:
                return

    def _take(self, message: dict[str, Any]) -> None:
        self._alive = time.monotonic()
        if "trouble" in message:
            self._trouble = str(message["trouble"])
            _log.info("stop_process", trouble=self._trouble)
        if "stop" in message:
            stop = message["stop"]
            word = (str(stop["by"]), str(stop["why"]), str(stop["press"]), str(stop["address"]))
            with self._attaching:
                if self._word is None:
                    self._early = [*self._early, word][:100]  # each of them holds the machine
                else:
                    self._word(*word)

    @staticmethod
    def _read(process: "subprocess.Popen[bytes]") -> dict[str, Any]:
        """The next line; empty at the end of the output."""
        line = process.stdout.readline() if process.stdout else b""
        return json.loads(line) if line.endswith(b"\n") else {}
