"""The service in this process, behind its ASGI interface: no port, and no process but the readers of bundles.

Whoever calls its address by httpx (a test, the client, a command) is led here: a request is a call in the thread of the
service's event loop. Jobs of the worker are done in a thread. There is no stop process, and nobody watches the host.
"""

import asyncio
import itertools
import json
import queue
import threading
from collections.abc import AsyncGenerator, Callable, Iterator, MutableMapping
from contextlib import asynccontextmanager, contextmanager, nullcontext
from pathlib import Path
from typing import Any, cast
from unittest.mock import patch

import httpx
import structlog
from fastapi import FastAPI

import service.web.application
from service import NotNow
from service.jobs.work import Answer, JobFailed, Work, Worker
from service.process.settings import Settings
from service.web.app import create_app, end_motion, end_streams

CONFIG = Path(__file__).parents[3] / "config"
HERE = "127.0.0.1"
PATIENCE = 120.0  # s
_HOSTED: dict[int, "Hosted"] = {}
_NUMBERS = itertools.count(101)  # as if they were ports; nobody listens at such

Message = MutableMapping[str, Any]
Parts = queue.SimpleQueue[Message | BaseException | None]


class Hosted:
    """One service, from its start to its end."""

    def __init__(self, settings: Settings, log: Path) -> None:
        self.number, self.log = next(_NUMBERS), log
        self._settings, self._app = settings, FastAPI()
        self._loop, self._over = asyncio.new_event_loop(), asyncio.Event()
        self._ready: queue.SimpleQueue[BaseException | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._serve, name=f"hosted service {self.number}")

    def start(self) -> None:
        _HOSTED[self.number] = self
        structlog.configure(
            processors=[structlog.contextvars.merge_contextvars, structlog.processors.format_exc_info, _note]
        )
        # a test that keeps this process from running is no suspended host
        with patch.multiple(service.web.application, open_worker=_in_threads, watching=lambda *_: nullcontext()):
            self._thread.start()
            error = self._ready.get()
        if error is not None:
            raise error

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._over.set)
        self._thread.join()
        self._loop.close()
        del _HOSTED[self.number]
        if not _HOSTED:
            structlog.reset_defaults()
        error = self._ready.get()
        if error is not None:
            raise error

    def answer(self, request: httpx.Request, address: str = HERE) -> httpx.Response:
        """`address`: from which it comes."""
        body, gone, parts = iter(cast("httpx.SyncByteStream", request.stream)), asyncio.Event(), Parts()

        async def receive() -> Message:
            if (piece := next(body, None)) is not None:
                return {"type": "http.request", "body": piece, "more_body": True}
            if not received:
                received.append(True)
                return {"type": "http.request", "body": b"", "more_body": False}
            await gone.wait()
            return {"type": "http.disconnect"}

        received: list[bool] = []
        self._call({"type": "http", "method": request.method, **self._scope(request, address)}, receive, parts)
        patience = request.extensions.get("timeout", {}).get("read")
        start = _next(parts, patience, request)
        assert start is not None
        stream = _Body(parts, patience, request, lambda: self._loop.call_soon_threadsafe(gone.set))
        return httpx.Response(start["status"], headers=start["headers"], stream=stream, request=request)

    def opened(self, path: str, headers: dict[str, str]) -> int:
        """The status with which a WebSocket is opened or refused."""
        request, parts = httpx.Request("GET", f"http://{HERE}:{self.number}{path}", headers=headers), Parts()
        told = iter([{"type": "websocket.connect"}, {"type": "websocket.disconnect", "code": 1000}])

        async def receive() -> Message:
            return next(told)

        self._call({"type": "websocket", "subprotocols": [], **self._scope(request, HERE)}, receive, parts)
        first = _next(parts, PATIENCE, request)
        assert first is not None
        return {"websocket.accept": 101, "websocket.close": 403}.get(first["type"]) or int(first["status"])

    def _scope(self, request: httpx.Request, address: str) -> Message:
        return {
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "scheme": request.url.scheme,
            "path": request.url.path,
            "raw_path": request.url.raw_path.partition(b"?")[0],
            "query_string": request.url.query,
            "root_path": "",
            "headers": [(name.lower(), value) for name, value in request.headers.raw],
            "server": (HERE, self.number),
            "client": (address, 50000),
            "state": {},
        }

    def _call(self, scope: Message, receive: Callable[[], Any], parts: Parts) -> None:
        async def send(message: Message) -> None:
            parts.put(message)

        async def run() -> None:
            try:
                await self._app(scope, receive, send)
                parts.put(None)
            except Exception as error:  # noqa: BLE001 - told to who called
                parts.put(error)

        asyncio.run_coroutine_threadsafe(run(), self._loop)

    def _serve(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._run())
        except BaseException as error:  # noqa: BLE001 - raised in the test's thread
            self._ready.put(error)
            return
        self._loop.run_until_complete(self._loop.shutdown_default_executor())
        self._ready.put(None)

    async def _run(self) -> None:
        self._app = create_app(self._settings, self._settings.answers_to)
        async with self._app.router.lifespan_context(self._app):
            self._ready.put(None)
            await self._over.wait()
            ending = asyncio.create_task(end_motion(self._app))
            end_streams(self._app)
            await ending


class _Body(httpx.SyncByteStream):
    """What comes of an answer, until its end or until nobody wants more."""

    def __init__(self, parts: Parts, patience: float | None, request: httpx.Request, leave: Callable[[], Any]) -> None:
        self._parts, self._patience, self._request, self._leave = parts, patience, request, leave

    def __iter__(self) -> Iterator[bytes]:
        more = True
        while more and (part := _next(self._parts, self._patience, self._request)) is not None:
            more = part.get("more_body", False)
            yield part.get("body", b"")

    def close(self) -> None:
        self._leave()


def _next(parts: Parts, patience: float | None, request: httpx.Request) -> Message | None:
    try:
        part = parts.get(timeout=patience)
    except queue.Empty:
        raise httpx.ReadTimeout("no answer", request=request) from None
    if isinstance(part, BaseException):
        raise httpx.ReadError(repr(part), request=request)
    return part


def _note(_logger: object, _method: str, event: Any) -> Any:
    for one in _HOSTED.values():
        with one.log.open("a", encoding="utf-8") as log:
            log.write(json.dumps(event, default=str) + "\n")
    raise structlog.DropEvent


class _Threads(Worker):
    """One job after another."""

    def __init__(self) -> None:
        self._turn = asyncio.Lock()

    async def run(self, job: Work[Answer]) -> Answer:
        async with self._turn:
            try:
                return await asyncio.to_thread(job)
            except NotNow:
                raise
            except Exception as error:  # noqa: BLE001 - as of a process
                raise JobFailed(f"{type(error).__name__}: {error}") from None

    async def processes(self) -> tuple[int, ...]:
        return ()

    async def close(self) -> None:
        pass


@asynccontextmanager
async def _in_threads(*_: object) -> AsyncGenerator[Worker]:
    yield _Threads()


class From(httpx.BaseTransport):
    """The way of requests from another address of this computer."""

    def __init__(self, address: str) -> None:
        self._address, self._real = address, httpx.HTTPTransport(local_address=address)

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        hosted = _HOSTED.get(request.url.port or 0)
        return self._real.handle_request(request) if hosted is None else hosted.answer(request, self._address)

    def close(self) -> None:
        self._real.close()


_handle_request = httpx.HTTPTransport.handle_request


def _led(self: httpx.HTTPTransport, request: httpx.Request) -> httpx.Response:
    hosted = _HOSTED.get(request.url.port or 0)
    return _handle_request(self, request) if hosted is None else hosted.answer(request)


httpx.HTTPTransport.handle_request = _led


def settings_of(folder: Path, profile: Path, **more: object) -> dict[str, Any]:
    """Of a service with its data in `folder`, which answers for the robots and the cell of this repository."""
    places = {"data_dir": folder / "data", "drive": profile}
    places |= {"robots_dir": CONFIG / "robots", "cells_dir": CONFIG / "cells"}
    return {name: str(place) for name, place in places.items()} | more


@contextmanager
def hosting(folder: Path, profile: Path, **more: object) -> Iterator[str]:
    """Yields its address; its log is `service.log` in `folder`."""
    hosted = Hosted(Settings.model_validate(settings_of(folder, profile, **more)), folder / "service.log")
    hosted.start()
    try:
        yield f"http://{HERE}:{hosted.number}"
    finally:
        hosted.close()


def opened(url: str, path: str, headers: dict[str, str]) -> int:
    """The status with which the service at `url` opens or refuses a WebSocket."""
    return _HOSTED[httpx.URL(url).port or 0].opened(path, headers)
