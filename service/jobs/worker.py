"""One worker process on this computer, connected by a pipe: a busy Python thread would delay the set-points.

It is started in the first cycle of the event loop, monitored also while it is idle, and restarted when it ends. Jobs
of higher priority run first; jobs of equal priority run in the order of their requests. Nothing listens on the
network: a process that can write to the pipe can run code.
"""

import asyncio
import itertools
import logging
import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import AsyncGenerator, Generator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, cast

import structlog
from structlog.contextvars import bound_contextvars

from service import NotNow
from service.jobs.work import TRACEPARENT, Answer, JobFailed, Work, Worker, work
from service.process.logs import configure_logs, current
from service.process.settings import Cluster, Telemetry
from service.process.tasks import ONE_THREAD, give_way
from service.process.telemetry import TRACING, traced

_log = structlog.get_logger(__name__)


class _Ended(Exception):
    """The process has ended."""


@dataclass(order=True)
class _WaitingJob:
    rank: int
    turn: int
    job: Work[object] = field(compare=False)
    answer: asyncio.Future[object] = field(compare=False)
    about: Mapping[str, object] = field(compare=False)  # fields of its log lines
    traceparent: str = field(compare=False)


@dataclass(frozen=True)
class _Process:
    """The process and the local end of the pipe. Methods block."""

    process: SpawnProcess
    pipe: "Connection[Any, Any]"

    @classmethod
    def start(cls, telemetry: Telemetry | None, machine: str) -> "_Process":
        context = multiprocessing.get_context("spawn")
        level = logging.getLogger().level
        ours, theirs = cast("tuple[Connection[Any, Any], Connection[Any, Any]]", context.Pipe())
        process = context.Process(target=_serve, args=(theirs, level, telemetry, machine), name="worker", daemon=True)
        with _own_environment():
            process.start()
        if process.pid is not None:
            with suppress(ProcessLookupError):  # it ended immediately: this is detected at the pipe
                give_way(process.pid)  # from the start: its imports alone need seconds of a processor
        theirs.close()
        return cls(process, ours)

    def hear(self) -> Any:
        """Its next message. _Ended if the process has ended."""
        try:
            return pickle.loads(self.pipe.recv_bytes())
        except (EOFError, OSError):
            self._gone()
            raise _Ended from None

    def do(self, job: bytes) -> tuple[bool, Any]:
        """Whether the job was done, and its result or the error. _Ended if the process has ended."""
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
        self.process.kill()  # a process with a broken pipe may still run
        self.process.join()


class WorkerProcess(Worker):
    """Runs one job at a time."""

    def __init__(self, telemetry: Telemetry | None = None, machine: str = "") -> None:
        """`telemetry`: destination of the spans of its jobs, which belong to `machine`."""
        self._telemetry, self._machine = telemetry, machine
        self._waiting: asyncio.PriorityQueue[_WaitingJob] = asyncio.PriorityQueue()
        self._turns = itertools.count()
        self._apart = ThreadPoolExecutor(1, thread_name_prefix="worker")  # starts the process and communicates with it
        self._process: _Process | None = None
        self._ready = asyncio.Event()
        self._closing = False
        self._serving = asyncio.create_task(self._serve(), name="worker process")

    async def run(self, job: Work[Answer]) -> Answer:
        answer: asyncio.Future[object] = asyncio.get_running_loop().create_future()
        self._waiting.put_nowait(
            _WaitingJob(-job.priority, next(self._turns), job, answer, current(), TRACING.traceparent)
        )
        return cast(Answer, await answer)

    async def processes(self) -> tuple[int, ...]:
        await self._ready.wait()
        pid = None if self._process is None else self._process.process.pid
        return () if pid is None else (pid,)

    async def close(self) -> None:
        self._closing = True
        if self._process is not None:
            self._process.process.kill()  # its waiting thread detects the end
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
                async with asyncio.timeout(1.0):  # s; an idle process is monitored, too
                    waiting = await self._waiting.get()
            except TimeoutError:
                continue
            if not waiting.answer.done():  # the caller may have cancelled
                try:
                    with bound_contextvars(**waiting.about):
                        about = {**waiting.about, TRACEPARENT: waiting.traceparent}
                        await self._do(waiting.job, waiting.answer, about)
                finally:
                    waiting.answer.cancel()  # no effect on an answer that is set

    async def _do(self, job: Work[object], answer: asyncio.Future[object], about: Mapping[str, object]) -> None:
        """Set the answer. The job is repeated if the process ended during it, but not forever: it may be the cause."""
        content, loop, attempts = pickle.dumps((job, about)), asyncio.get_running_loop(), 4
        for attempt in range(1, attempts + 1):
            process = await self._alive()
            try:
                done, result = await loop.run_in_executor(self._apart, process.do, content)
            except _Ended:
                _log.warning("worker_ended", job=job.key, attempt=attempt)
                continue
            break
        else:
            done, result = False, f"the worker process ended {attempts} times while it executed this job"
        if answer.done():
            return
        if done:
            answer.set_result(result)
        else:
            answer.set_exception(result if isinstance(result, NotNow) else JobFailed(str(result)))

    async def _alive(self) -> _Process:
        """The process; it is started if it does not run."""
        while True:
            if self._process is not None:
                if self._process.process.is_alive():
                    return self._process
                self._ready.clear()
                self.trouble = "the worker process ended and is restarted"
                _log.warning("worker_replaced", exit_code=self._process.process.exitcode)
                self._process.end()
                self._process = None
            try:
                await asyncio.get_running_loop().run_in_executor(self._apart, self._start)
            except (_Ended, OSError) as error:
                self.trouble = f"the worker process does not start: {str(error) or 'the log has the reason'}"
                _log.error("worker_not_started", reason=str(error))
                await asyncio.sleep(1.0)  # until the restart
            else:
                self._ready.set()
                self.trouble = ""

    def _start(self) -> None:
        """Runs in the thread of the pipe, so that `close` also knows a process whose start was cancelled."""
        self._process = _Process.start(self._telemetry, self._machine)
        if self._closing:
            raise _Ended
        self._process.hear()


def _serve(pipe: "Connection[Any, Any]", level: int, telemetry: Telemetry | None, machine: str) -> None:
    """The worker process: executes the jobs from the pipe until its other end is closed."""
    configure_logs(level)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal's signal is handled by the service
    threading.Thread(target=_end_with_service, name="end with the service", daemon=True).start()
    with traced(telemetry, machine, "worker"):
        pipe.send_bytes(pickle.dumps("ready"))
        while True:
            try:
                job = pipe.recv_bytes()
            except EOFError:
                return
            pipe.send_bytes(_answer(job))


def _answer(job: bytes) -> bytes:
    try:
        return pickle.dumps((True, work(*cast("tuple[Work[object], dict[str, object]]", pickle.loads(job)))))
    except NotNow as error:  # the job can be submitted again
        return pickle.dumps((False, error))
    except Exception as error:  # noqa: BLE001 - any error belongs to the job and is reported to its caller
        return pickle.dumps((False, f"{type(error).__name__}: {error}"))


def _end_with_service() -> None:
    """End together with the service, also during a job."""
    service = multiprocessing.parent_process()
    if service is not None:
        service.join()
        os._exit(1)


@contextmanager
def _own_environment() -> Generator[None]:
    """Sets the environment of a worker during the block: a child process gets it only from its parent."""
    # glibc returns the memory of a finished job; without it, 900 sweeps leave some 60 MB more in the process than 100
    variables = {**ONE_THREAD, "MALLOC_TRIM_THRESHOLD_": "65536"}
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


@asynccontextmanager
async def open_worker(
    cluster: Cluster | None, telemetry: Telemetry | None = None, machine: str = ""
) -> AsyncGenerator[Worker]:
    """The workers of a Dask cluster, or (None) one local worker process; its jobs are spans of `telemetry`."""
    if cluster is None:
        worker: Worker = WorkerProcess(telemetry, machine)
    else:
        # Dask is imported only if a cluster is used
        from service.jobs.dask_workers import DaskWorkers

        worker = DaskWorkers(cluster)
    try:
        yield worker
    finally:
        await worker.close()
