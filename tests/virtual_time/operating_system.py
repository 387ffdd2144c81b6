"""The pipes and processes that the service's stop process needs, in memory.

`handle` and `__main__` of `service.machine.stop_process` run unchanged, each in its own simulated process: only their
`os`, `subprocess` and `sys` are those of this module, and the port of the stop process is at the level of `Request` and
`Answer` (`Listener`) instead of HTTP.
"""

import itertools
import queue
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

from service.machine.stop_process import __main__ as stop_process, handle
from service.machine.stop_process.listener import BEAT, Answer, Answered, Request
from tests.virtual_time import primitives
from tests.virtual_time.primitives import SimpleQueue
from tests.virtual_time.scheduler import Process

_END_OF_FILE = b""


class Pipe:
    """What was written as it was written; after the writer has ended, its end is read again and again."""

    def __init__(self) -> None:
        self._queue = SimpleQueue()

    def write(self, data: bytes) -> int:
        self._queue.put(data)
        return len(data)

    def read(self) -> bytes:
        data: bytes = self._queue.get()
        if data == _END_OF_FILE:
            self._queue.give_back(data)
        return data

    readline = read

    def close(self) -> None:
        self._queue.put_nowait(_END_OF_FILE)


_numbers = itertools.count(1 << 20)
_files: dict[int, Pipe] = {}
_programs: dict[Process, "Popen"] = {}
LISTENERS: dict[int, "Listener"] = {}


def _pipe() -> tuple[int, int]:
    """Its writing end belongs to the calling process."""
    both = Pipe()
    reading, writing = next(_numbers), next(_numbers)
    _files[reading] = _files[writing] = both
    primitives.world.current.process.at_end.append(both.close)
    return reading, writing


def _close(number: int) -> None:
    _files.pop(number).close()


def _mine() -> "Popen":
    return _programs[primitives.world.current.process]


def _exit(_code: int) -> None:
    primitives.world.kill(primitives.world.current.process)


class Popen:
    """subprocess.Popen of `python -P -m service.machine.stop_process ...`: a simulated process with one thread."""

    def __init__(self, command: Sequence[str], stdin: int, stdout: int, start_new_session: bool) -> None:
        del stdout, start_new_session
        assert command[1:4] == ["-P", "-m", "service.machine.stop_process"], command
        self.argv = command[3:]
        self.stdin, self.stdout = _files[stdin], Pipe()
        self.process = Process("stop process")
        self.process.at_end.append(self.stdout.close)
        _programs[self.process] = self
        world = primitives.world
        self._thread = world.add("main", self.process)
        world.start(self._thread, self._run)

    def _run(self) -> None:
        with suppress(SystemExit):
            stop_process.main()
        primitives.world.kill(self.process)

    def wait(self, timeout: float | None = None) -> int:
        world = primitives.world
        if not self._thread.done:
            self._thread.joiners.append(world.current)
            if not world.wait("the end of the stop process", None if timeout is None else world.now + timeout):
                raise subprocess.TimeoutExpired("stop process", timeout or 0.0)
        return 0

    def kill(self) -> None:
        primitives.world.kill(self.process)


class Listener:
    """The port of the stop process: a request after the other; their answers come later."""

    def __init__(
        self,
        host: str,
        port: int,
        stop: Callable[[Request, Answered], None],
        status: Callable[[], Answer],
        tls: object,
        alive: Callable[[], None],
    ) -> None:
        del host, tls
        self.port = port
        self._stop, self._status, self._alive = stop, status, alive
        self._inbox = SimpleQueue()
        LISTENERS[port] = self

    def serve(self) -> None:
        beat = primitives.monotonic()
        while True:
            try:
                request, answer = self._inbox.get(timeout=max(0.0, beat - primitives.monotonic()))
            except queue.Empty:
                beat = primitives.monotonic() + BEAT
                self._alive()
                continue
            if request is None:
                answer.put(self._status())
            else:
                self._stop(request, answer.put)

    def ask(self, request: Request | None) -> SimpleQueue:
        """Where the answer comes; None asks for the status."""
        answer = SimpleQueue()
        self._inbox.put((request, answer))
        return answer


class _Sys:
    stderr = sys.stderr

    @property
    def argv(self) -> Sequence[str]:
        return _mine().argv


def install() -> None:
    """For this process of the computer."""
    service_side: Any = handle
    service_side.os = SimpleNamespace(
        pipe=_pipe,
        close=_close,
        write=lambda number, data: _files[number].write(data),
        set_blocking=lambda number, blocking: None,
    )
    service_side.subprocess = SimpleNamespace(
        Popen=Popen, PIPE=subprocess.PIPE, TimeoutExpired=subprocess.TimeoutExpired
    )
    own_side: Any = stop_process
    own_side.os = SimpleNamespace(
        read=lambda _number, _most: _mine().stdin.read(),
        getpid=lambda: id(_mine()),
        _exit=_exit,
        write=lambda _number, data: _mine().stdout.write(data),
        set_blocking=lambda _number, _blocking: None,
    )
    own_side.sys = _Sys()
    own_side.Listener = Listener
