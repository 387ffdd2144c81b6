"""`sweepid serve` in a simulated process: the application behind its ASGI interface, its stop process, its worker.

What is replaced: uvicorn (requests are calls), the processes of stop and worker, and how long SQLite waits.
"""

import asyncio
import json
import shutil
import sqlite3
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import Future
from contextlib import asynccontextmanager, contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

import httpx
import structlog
from fastapi import FastAPI
from sqlalchemy import Connection, Engine, create_engine
from sqlalchemy.exc import OperationalError

import service.store.database
import service.web.application
from service.jobs.work import Answer, Work, Worker
from service.machine.execution.machine import Machine
from service.machine.stop_process.handle import StopProcess
from service.machine.stop_process.listener import LONGEST_WAIT, Request
from service.process.settings import Settings
from service.store.database import BUSY_TIMEOUT, PATIENCE_OPTION, WRITE
from service.web.app import create_app, end_motion, end_streams
from service.web.client import ServiceClient
from tests.virtual_time import operating_system, primitives
from tests.virtual_time.clock import Clock
from tests.virtual_time.machine import CONFIG, VirtualMachine
from tests.virtual_time.scheduler import Process

HOST, PORT = "127.0.0.1", 8642
JOB = 0.2  # s that a job of the worker takes
_ENGINES: list[Engine] = []
_BUSY = 0.01  # s after which a writer tries again


class Killed(httpx.ConnectError):
    """The service was killed before it answered."""


class VirtualService:
    """May be killed and started again on the same data. `client` is a client of its API."""

    def __init__(self, folder: Path, machine: VirtualMachine, clock: Clock, **settings: Any) -> None:
        self.data = folder / "data"
        self.log: list[str] = []
        self.job = JOB
        """s that a job of the worker takes."""
        self.plans: list[int] = []
        self._clock, self._graves, self._snapshots = clock, 0, 0
        own: dict[str, Any] = {
            "data_dir": self.data,
            "drive": machine.profile,
            "robots_dir": CONFIG / "robots",
            "cells_dir": CONFIG / "cells",
            "port": PORT,
            "virtual_machine": True,
        }
        self.settings = Settings(**own | settings)
        self.url = f"http://{HOST}:{PORT}"
        self.process = Process("service")
        self._loop: asyncio.AbstractEventLoop | None = None
        self._app: FastAPI | None = None
        self._open: set[Future[httpx.Response]] = set()
        _install(self)
        self.client = ServiceClient(self.url)

    # -- its life

    def start(self) -> None:
        """Returns when it is ready."""
        world = primitives.world
        self.process = Process("service")
        self.process.at_end.append(self._cut_off)
        self._ready, self._over = threading.Event(), asyncio.Event()
        self._error: BaseException | None = None
        self._main = world.add("main", self.process)
        world.start(self._main, self._serve)
        self._ready.wait()
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """As told to end by SIGTERM."""
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._over.set)
            if not self._main.done:
                self._main.joiners.append(primitives.world.current)
                primitives.world.wait("the end of the service")
            if self._error is not None:
                raise self._error

    def kill(self) -> None:
        """SIGKILL; its files stay as they are, with what it had not written missing."""
        primitives.world.kill(self.process)
        self.bury()

    def bury(self) -> None:
        """After it was killed, before it is started again."""
        # what the dead process still holds open in this one, locks included, is not the new service's
        self._graves += 1
        grave = self.data.with_name(f"data.killed-{self._graves}")
        self.data.rename(grave)
        shutil.copytree(grave, self.data, ignore=shutil.ignore_patterns("*-shm"))

    @contextmanager
    def blocked_database(self) -> Iterator[None]:
        """Another program writes to the database during the block and does not end."""
        other = sqlite3.connect(self.data / "sweepid.sqlite", timeout=0.0, isolation_level=None)
        while not other.in_transaction:
            with suppress(sqlite3.OperationalError):  # the service writes
                other.execute("BEGIN IMMEDIATE")
                break
            self._clock.sleep(_BUSY)
        try:
            yield
        finally:
            other.execute("ROLLBACK")
            other.close()

    def block_loop(self, seconds: float) -> None:
        """Its event loop does nothing else for so long; its other threads run."""
        assert self._loop is not None
        self._loop.call_soon_threadsafe(primitives.sleep, seconds)

    def snapshot(self) -> Callable[[], None]:
        """Before copies of this process are made: what puts the files back as they are now, for each copy.

        The database is closed meanwhile: no connection may come along into a copy.
        """
        for engine in _ENGINES:
            while engine.pool.checkedout():  # pyright: ignore[reportAttributeAccessIssue]
                self._clock.sleep(0.01)
            engine.dispose()
        self._snapshots += 1
        pristine = self.data.with_name(f"data.snapshot-{self._snapshots}")
        shutil.copytree(self.data, pristine)

        def restore() -> None:
            for left in (self.data, *self.data.parent.glob("data.killed-*")):
                shutil.rmtree(left)
            shutil.copytree(pristine, self.data)

        return restore

    @property
    def machine_inside(self) -> Machine | None:
        """What the service says of its machine, if anybody could ask it now; its clock may be read from anywhere."""
        if self._app is None or self.process.suspended or self.process.killed:
            return None
        machine: Machine = self._app.state.application.machine
        reports: Any = machine._reports  # pyright: ignore[reportPrivateUsage]
        reports._clock = lambda: primitives.world.now
        return machine

    # -- requests

    def send(self, method: str, path: str, content: object = None) -> "Future[httpx.Response]":
        """A request that arrives now; the answer comes later, if at all (`Killed`). `path` within the API."""
        body = b"" if content is None else json.dumps(content).encode()
        headers = {"content-type": "application/json"} if body else None
        return self.request(httpx.Request(method, f"{self.url}/api/v1{path}", content=body, headers=headers))

    def request(self, request: httpx.Request) -> "Future[httpx.Response]":
        body = request.read()
        if self._loop is None or self._app is None:
            raise httpx.ConnectError("no service", request=request)
        answer: Future[httpx.Response] = Future()
        self._open.add(answer)

        async def respond() -> None:
            assert self._app is not None
            try:
                response = await _call(self._app, request, body, answer)
            except BaseException as error:  # noqa: BLE001 - the caller's
                response = None
                if not answer.done():
                    answer.set_exception(error)
            self._open.discard(answer)
            if response is not None and not answer.done():
                answer.set_result(response)

        loop = self._loop
        loop.call_soon_threadsafe(lambda: loop.create_task(respond(), name="request"))
        return answer

    def press_stop(
        self, by: str = "test", why: str = "test", press: str = "", wait: float = LONGEST_WAIT
    ) -> primitives.SimpleQueue:
        """POST /stop at the port of the stop process; the answer comes in the queue."""
        return operating_system.LISTENERS[self.settings.stop_listens_at].ask(Request(by, why, press, HOST, wait))

    # -- inside

    def _cut_off(self) -> None:
        self._loop = self._app = None
        for answer in self._open:
            if not answer.done():
                answer.set_exception(Killed("the service was killed"))
        self._open.clear()

    def _serve(self) -> None:
        try:
            with StopProcess(self.settings.drive, HOST, self.settings.stop_listens_at) as stop_process:
                asyncio.run(self._run(stop_process))
        except BaseException as error:  # noqa: BLE001 - told to the test
            self._error = error
        self._loop = self._app = None
        self._ready.set()
        for close in self.process.at_end:
            close()

    async def _run(self, stop_process: StopProcess) -> None:
        self._over = asyncio.Event()
        app = create_app(self.settings, self.settings.answers_to, stop_process)
        async with app.router.lifespan_context(app):
            self._app, self._loop = app, asyncio.get_running_loop()
            self._ready.set()
            await self._over.wait()
            ending = asyncio.create_task(end_motion(app), name="end of motion")
            end_streams(app)
            await ending
            self._loop = None


def add_campaign(service: VirtualService, poses: int = 1, **changes: object) -> int:
    """A campaign of two axes; its number. Nothing moves yet."""
    (robot,) = (each for each in service.client.robots() if each["name"] == "max100-class")
    wanted = {"axes": ["joint_1", "joint_2"], "varied": ["joint_2", "joint_3"], "step": 30.0, "poses": poses}
    plan = service.client.add_plan({"robot_id": robot["id"], "move_velocity": 0.5} | wanted | changes)
    service.plans.append(plan["id"])
    return int(service.client.add_campaign(plan["id"])["id"])


async def _call(app: FastAPI, request: httpx.Request, body: bytes, answer: "Future[httpx.Response]") -> httpx.Response:
    """One request by ASGI; a caller that gives `answer` up has closed its connection."""
    scope = {
        "type": "http",
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "method": request.method,
        "scheme": "http",
        "path": request.url.path,
        "raw_path": request.url.raw_path.partition(b"?")[0],
        "query_string": request.url.query,
        "root_path": "",
        "headers": [(name.lower(), value) for name, value in request.headers.raw],
        "server": (HOST, PORT),
        "client": (HOST, 50000),
        "state": {},
    }
    loop, gone = asyncio.get_running_loop(), asyncio.Event()
    answer.add_done_callback(lambda _: loop.call_soon_threadsafe(gone.set) if answer.cancelled() else None)
    received = False
    start: dict[str, Any] = {}
    content = bytearray()

    async def receive() -> dict[str, Any]:
        nonlocal received
        if not received:
            received = True
            return {"type": "http.request", "body": body, "more_body": False}
        await gone.wait()
        return {"type": "http.disconnect"}

    async def send(message: dict[str, Any]) -> None:
        if message["type"] == "http.response.start":
            start.update(message)
        else:
            content.extend(message.get("body", b""))

    await app(scope, receive, send)  # pyright: ignore[reportArgumentType]
    return httpx.Response(start["status"], headers=start["headers"], content=bytes(content), request=request)


class WorkerInProcess(Worker):
    """A job takes virtual time; it is done at once, in one call, in a thread."""

    def __init__(self, service: VirtualService) -> None:
        self._service = service

    async def run(self, job: Work[Answer]) -> Answer:
        await asyncio.sleep(self._service.job)
        return await asyncio.to_thread(job)

    async def processes(self) -> tuple[int, ...]:
        return ()

    async def close(self) -> None:
        pass


def _begin(connection: Connection) -> None:
    """As `_begin_sqlite`; but SQLite would wait for another writer in C, where no other thread of this process runs."""
    options = connection.get_execution_options()
    connection.exec_driver_sql("PRAGMA busy_timeout = 0")
    deadline = primitives.monotonic() + options.get(PATIENCE_OPTION, BUSY_TIMEOUT)
    while True:
        try:
            connection.exec_driver_sql("BEGIN IMMEDIATE" if options.get(WRITE, False) else "BEGIN")
        except OperationalError:
            if primitives.monotonic() >= deadline:
                raise
            primitives.sleep(_BUSY)
        else:
            return


def _install(service_of_tests: VirtualService) -> None:
    """For this process of the computer."""
    operating_system.install()

    @asynccontextmanager
    async def open_worker(*_: object) -> AsyncIterator[Worker]:
        yield WorkerInProcess(service_of_tests)

    application: Any = service.web.application
    application.open_worker = open_worker
    sqlite: Any = service.store.database
    sqlite._begin_sqlite = _begin
    configure = sqlite._configure_sqlite

    def configured(connection: sqlite3.Connection, record: object) -> None:
        configure(connection, record)
        connection.execute("PRAGMA synchronous = OFF")  # a killed process keeps its files; only a power cut does not

    sqlite._configure_sqlite = configured

    def remembered(*args: Any, **more: Any) -> Engine:
        _ENGINES.append(create_engine(*args, **more))
        return _ENGINES[-1]

    sqlite.create_engine = remembered

    def handle_request(self: httpx.HTTPTransport, request: httpx.Request) -> httpx.Response:
        del self
        if request.url.port == service_of_tests.settings.stop_listens_at:
            query = parse_qs(request.url.query.decode())
            by, why, press = (query.get(name, [""])[0] for name in ("by", "why", "press"))
            status, document = service_of_tests.press_stop(by, why, press).get()
            return httpx.Response(status, json=document, request=request)
        answer = service_of_tests.request(request)
        try:
            return answer.result(request.extensions.get("timeout", {}).get("read"))
        except TimeoutError:
            answer.cancel()
            raise httpx.ReadTimeout("no answer", request=request) from None

    httpx.HTTPTransport.handle_request = handle_request

    def note(_logger: object, _method: str, event: Any) -> Any:
        with suppress(TypeError):
            service_of_tests.log.append(json.dumps(event, default=str, ensure_ascii=False))
        raise structlog.DropEvent

    structlog.configure(processors=[note], cache_logger_on_first_use=False)
