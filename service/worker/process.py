"""One worker process on this computer, at the other end of a pipe.

It is started with the first turn of the event loop, watched also while it has nothing to do, and started anew when it
ends. Who waits for a job of higher priority comes first, then who asked first. Nothing listens on the network: whoever
may write into the pipe may run code.
"""

import asyncio
import itertools
import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, ParamSpec, TypeVar, cast

import structlog

from service.worker.jobs import Answer, Work
from service.worker.worker import JobFailed, Worker, give_way, work

_log = structlog.get_logger(__name__)

_ONE_THREAD: Mapping[str, str] = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
P = ParamSpec("P")
R = TypeVar("R")

_ATTEMPTS = 4  # of one job: what ends the process so often is the job's own doing, such as its need of memory
_LOOK = 1.0  # s between looks at a process that has nothing to do
_AGAIN = 1.0  # s before a process that ended is started anew


class _Ended(Exception):
    """The process is gone."""


@dataclass(order=True)
class _Waiting:
    rank: int
    turn: int
    job: Work[object] = field(compare=False)
    answer: asyncio.Future[object] = field(compare=False)


@dataclass(frozen=True)
class _Process:
    """The process and our end of the pipe. Methods block."""

    process: SpawnProcess
    pipe: "Connection[Any, Any]"

    @classmethod
    def start(cls) -> "_Process":
        context = multiprocessing.get_context("spawn")
        ours, theirs = cast("tuple[Connection[Any, Any], Connection[Any, Any]]", context.Pipe())
        process = context.Process(target=_serve, args=(theirs,), name="worker", daemon=True)
        with _environment(_ONE_THREAD):
            process.start()
        if process.pid is not None:
            with suppress(ProcessLookupError):  # it ended at once: who hears its pipe is told
                give_way(process.pid)  # from its first import on, which alone takes seconds of a processor
        theirs.close()
        return cls(process, ours)

    def hear(self) -> Any:
        """What it says next; _Ended."""
        try:
            return pickle.loads(self.pipe.recv_bytes())
        except (EOFError, OSError):
            self._gone()
            raise _Ended from None

    def do(self, job: bytes) -> tuple[bool, Any]:
        """Whether the job was done, and its result or what went wrong; _Ended."""
        try:
            self.pipe.send_bytes(job)
        except OSError:
            self._gone()
            raise _Ended from None
        return cast("tuple[bool, Any]", self.hear())

    def end(self) -> None:
        self._gone()
        self.process.close()
        self.pipe.close()

    def _gone(self) -> None:
        self.process.kill()  # who does not speak any more may still be there
        self.process.join()


class WorkerProcess(Worker):
    """One job at a time."""

    def __init__(self) -> None:
        self._waiting: asyncio.PriorityQueue[_Waiting] = asyncio.PriorityQueue()
        self._turns = itertools.count()
        self._apart = ThreadPoolExecutor(1, thread_name_prefix="worker")  # starts it and speaks with it
        self._process: _Process | None = None
        self._ready = asyncio.Event()
        self._closing = False
        self._serving = asyncio.create_task(self._serve(), name="worker process")

    async def run(self, job: Work[Answer]) -> Answer:
        answer: asyncio.Future[object] = asyncio.get_running_loop().create_future()
        self._waiting.put_nowait(_Waiting(-job.priority, next(self._turns), job, answer))
        return cast(Answer, await answer)

    async def processes(self) -> tuple[int, ...]:
        await self._ready.wait()
        pid = None if self._process is None else self._process.process.pid
        return () if pid is None else (pid,)

    async def close(self) -> None:
        self._closing = True
        if self._process is not None:
            self._process.process.kill()  # its thread, that waits for it, hears that it ended
        self._serving.cancel()
        await asyncio.wait([self._serving])
        await asyncio.to_thread(self._apart.shutdown)
        if self._process is not None:
            self._process.end()
            self._process = None
        while not self._waiting.empty():
            self._waiting.get_nowait().answer.cancel()

    async def _serve(self) -> None:
        while True:
            await self._alive()
            try:
                waiting = await asyncio.wait_for(self._waiting.get(), _LOOK)
            except TimeoutError:
                continue
            if not waiting.answer.done():  # who asked may have gone
                try:
                    await self._do(waiting.job, waiting.answer)
                finally:
                    waiting.answer.cancel()  # no effect on one that was given

    async def _do(self, job: Work[object], answer: asyncio.Future[object]) -> None:
        """Give the answer; the job is done again where the process ended under it."""
        content = pickle.dumps(job)
        for attempt in range(1, _ATTEMPTS + 1):
            process = await self._alive()
            try:
                done, result = await self._in_thread(process.do, content)
            except _Ended:
                _log.warning("worker_ended", job=job.key, attempt=attempt)
                continue
            break
        else:
            done, result = False, f"the worker process ended under it {_ATTEMPTS} times"
        if answer.done():
            return
        if done:
            answer.set_result(result)
        else:
            answer.set_exception(JobFailed(str(result)))

    async def _alive(self) -> _Process:
        """The process, started (anew) if there is none."""
        while True:
            if self._process is not None:
                if self._process.process.is_alive():
                    return self._process
                self._ready.clear()
                self.trouble = "the worker process ended and is started anew"
                _log.warning("worker_replaced", exit_code=self._process.process.exitcode)
                self._process.end()
                self._process = None
            try:
                await self._in_thread(self._start)
            except (_Ended, OSError) as error:
                self.trouble = f"the worker process does not start: {str(error) or 'the log has the reason'}"
                _log.error("worker_not_started", reason=str(error))
                await asyncio.sleep(_AGAIN)
            else:
                self._ready.set()
                self.trouble = ""

    def _start(self) -> None:
        """In its thread, so that also a start that nobody waits for any more is known to `close`."""
        self._process = _Process.start()
        if self._closing:
            raise _Ended
        self._process.hear()

    async def _in_thread(self, what: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        return await asyncio.get_running_loop().run_in_executor(self._apart, partial(what, *args, **kwargs))


def _serve(pipe: "Connection[Any, Any]") -> None:
    """The worker process: does what comes through the pipe until its other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal's is for the service
    threading.Thread(target=_end_with_service, name="end with the service", daemon=True).start()
    pipe.send_bytes(pickle.dumps("ready"))
    while True:
        try:
            job = pipe.recv_bytes()
        except EOFError:
            return
        pipe.send_bytes(_answer(job))


def _answer(job: bytes) -> bytes:
    try:
        return pickle.dumps((True, work(cast("Work[object]", pickle.loads(job)))))
    except Exception as error:  # noqa: BLE001 - whatever it is, it is the job's and told to who asked
        return pickle.dumps((False, f"{type(error).__name__}: {error}"))


def _end_with_service() -> None:
    """Also in the middle of a job that nobody waits for any more."""
    service = multiprocessing.parent_process()
    if service is not None:
        service.join()
        os._exit(1)


@contextmanager
def _environment(variables: Mapping[str, str]) -> Generator[None]:
    """With these environment variables: those of a process that is started cannot be given otherwise."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
