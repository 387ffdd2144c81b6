"""A service whose answers a test writes: the real pages, answers of the documented shapes, and a count of what arrives.

It speaks HTTP/1.1 as the real one does. The stop process is a second server, or nobody.
"""

import asyncio
import socket
import threading
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import parse_qs

import uvicorn
from fastapi import FastAPI
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket

from service.web.hmi.pages import add_pages

Json = dict[str, Any]
JOINTS = ("joint_1", "joint_2")
STANDS = {"state": "stands", "age": 0.1, "reason": ""}
EMPTY: Json = {"items": [], "next": None}
CONFIRMED: Json = {"sent": [*JOINTS], "confirmed": [*JOINTS], "unconfirmed": {}}
_LOCAL: Json = {"login": False, "name": "local", "role": "admin", "session": False, "refused": {}}


def axis(joint: str, **changed: object) -> Json:
    """An axis at rest, as in GET /drives."""
    rest = {"state": "disabled", "position": 0.0, "velocity": 0.0, "effort": 0.0, "fault": None, "identity": None}
    return {"joint": joint, **rest, **changed}


def statement(state: str = "stands", reason: str = "", **axes: str) -> Json:
    """As in GET /drives and GET /stop: every axis stands but those that are named with their state."""
    of_axes = {joint: STANDS | {"state": axes.get(joint, "stands")} for joint in JOINTS}
    return {"state": state, "age": 0.1, "reason": reason, "axes": of_axes}


def drives(**changed: object) -> Json:
    """A connected machine at rest."""
    rest: Json = {
        "connected": True,
        "trouble": "",
        "trouble_cause": None,
        "held": "",
        "capabilities": None,
        "statement": statement(),
    }
    return rest | {"axes": [axis(joint) for joint in JOINTS]} | changed


def campaign(number: int = 1, **changed: object) -> Json:
    """A paused one without a plan."""
    rest: Json = {
        "id": number, "machine": "cell", "here": True, "robot_id": 1, "plan_id": None, "state": "paused", "cause": "",
        "structured_cause": None,
        "version": 1, "sweeps": {}, "created_at": "2026-03-02T12:00:00Z", "started_at": None, "motion": [],
        "progress": {"done": 0, "total": 2, "remaining": 60.0, "repeat": 0.0, "pace": 1.0, "current": None},
        "check_move": None, "attended": None, "data_check": None,
    }  # fmt: skip
    return rest | changed


HELD: Json = {"id": 7, "by": "operator page", "why": "stop button", "at": "2026-03-02T12:00:00Z", "cause": None}
"""A latched stop."""


def cause(code: str, **fields: object) -> Json:
    """As in GET /campaigns."""
    return {"code": code, "joint": "", "value": None, "limit": None, "unit": "", "by": "", "detail": ""} | fields


def robot() -> Json:
    """Two rotary axes."""
    joints = "".join(f'<joint name="{joint}" type="revolute"/>' for joint in JOINTS)
    return {"id": 1, "description": {"axes": [{"joint": joint} for joint in JOINTS]}, "urdf_text": f"<r>{joints}</r>"}


@dataclass
class Scripted:
    """`answers`: by path below the API; what is missing is an empty page. `stop`: status and content of STOP."""

    answers: dict[str, Json] = field(default_factory=dict[str, Json])
    stop: tuple[int, Json] = (200, CONFIRMED)
    pdf: bool = True
    """Whether it makes PDF."""
    url: str = ""
    stops: list[tuple[str, Json]] = field(default_factory=list[tuple[str, Json]])
    """Path and query of each stop that arrived."""
    requests: Counter[str] = field(default_factory=Counter[str])
    keys: list[str | None] = field(default_factory=list[str | None])
    """Of each connection for events, its key."""
    streams: int = 0
    """Connections for events that are open."""
    sockets: int = 0
    """Connections for live samples that were opened."""
    offered: list[str] = field(default_factory=list[str])
    """Subprotocols of the last of them."""
    known: set[str | None] | None = None
    """The keys that are valid; None: all, and no key."""
    frozen: set[str] = field(default_factory=set[str])
    """Paths that are not answered."""

    def __post_init__(self) -> None:
        self._queues: list[asyncio.Queue[str]] = []
        self._shown: list[WebSocket] = []
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ending = asyncio.Event()
        for path, answer in {
            "stop": {
                "latched": False,
                "stop": None,
                "stops": [],
                "port": None,
                "process_trouble": "",
                "statement": statement(),
            },
            "drives": drives(),
            "me": _LOCAL,
            "robots/1": robot(),
            "cells": {"names": []},
            "fleet": {"types": []},
            "machines": EMPTY | {"missing": []},
        }.items():
            self.answers.setdefault(path, answer)

    def tell(self, kind: str) -> None:
        """One event to every open connection."""
        assert self._loop is not None
        for queue in [*self._queues]:
            self._loop.call_soon_threadsafe(queue.put_nowait, kind)

    def show(self, block: Json) -> None:
        """Live samples to every open connection."""
        assert self._loop is not None
        asyncio.run_coroutine_threadsafe(self._show(block), self._loop).result()

    async def _show(self, block: Json) -> None:
        for one in self._shown:
            await one.send_json(block)

    def cut(self) -> None:
        """End every connection for events, as a service does that starts again."""
        self.tell("")

    def app(self, stop_port: int | None, behind_proxy: bool) -> ASGIApp:
        """With `behind_proxy`, `/stop` as a proxy forwards it."""
        pages = FastAPI(openapi_url=None)
        add_pages(pages, stop_port, lambda: self.pdf, behind_proxy)
        at_proxy = [Route("/stop", self._stop, methods=["POST"])] if behind_proxy else []
        pages.router.routes += [
            Route("/api/v1/events", self._events),
            WebSocketRoute("/api/v1/campaigns/{number}/live", self._live),
            Route("/api/v1/stop", self._stop, methods=["POST"]),
            Route("/api/v1/{path:path}", self._answer, methods=["GET", "POST"]),
            *at_proxy,
        ]
        return pages

    def stop_process(self) -> ASGIApp:
        """The port of the stop process."""
        return Mount("/", routes=[Route("/stop", self._stop, methods=["POST"])])

    async def _stop(self, request: Request) -> Response:
        self._loop = asyncio.get_running_loop()
        self.stops.append((request.url.path, {name: value[0] for name, value in parse_qs(request.url.query).items()}))
        if request.url.path in self.frozen:
            await self._ending.wait()
        status, content = self.stop
        kind = "application/json" if status < 400 else "application/problem+json"
        return JSONResponse(content, status, {"Access-Control-Allow-Origin": "*"}, kind)

    async def _answer(self, request: Request) -> Response:
        self._loop = asyncio.get_running_loop()
        path = request.path_params["path"]
        self.requests[path] += 1
        if path in self.frozen:
            await self._ending.wait()
        if self.known is not None and path != "stop" and key_of(request) not in self.known:
            return problem(401, "unauthorized", "not authenticated: send a key")
        if path.endswith("estimates/latest") and path not in self.answers:
            return problem(404, "not-found", "no estimate")
        return JSONResponse(self.answers.get(path, EMPTY))

    async def _events(self, request: Request) -> Response:
        key = key_of(request)
        self.keys.append(key)
        if self.known is not None and key not in self.known:
            return problem(401, "unauthorized", "not authenticated: send a key")
        return StreamingResponse(self._follow(), media_type="text/event-stream")

    async def _follow(self) -> AsyncIterator[str]:
        queue: asyncio.Queue[str] = asyncio.Queue()
        self._queues.append(queue)
        self.streams += 1
        try:
            yield ": connected\n\n"
            while kind := await queue.get():
                yield f"event: {kind}\ndata: {{}}\nid: {len(self.keys)}\n\n"
        finally:
            self.streams -= 1
            self._queues.remove(queue)

    async def _live(self, socket: WebSocket) -> None:
        await socket.accept("sweepid.live")
        self._shown.append(socket)
        self.sockets += 1
        self.offered = socket.scope["subprotocols"]
        while (await socket.receive())["type"] != "websocket.disconnect":
            pass
        self._shown.remove(socket)

    def close(self) -> None:
        """Let every request that waits go on."""
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._ending.set)
            self.cut()


def key_of(request: Request) -> str | None:
    """Of its header."""
    return request.headers.get("authorization", " ").partition(" ")[2] or None


def problem(status: int, name: str, detail: str) -> Response:
    """As in RFC 9457."""
    content = {"type": f"urn:sweepid:problem:{name}", "title": name, "status": status, "detail": detail, "instance": ""}
    return JSONResponse(content, status, media_type="application/problem+json")


@contextmanager
def scripted(
    stop_port: str = "none", behind_proxy: bool = False, answers: dict[str, Json] | None = None
) -> Iterator[Scripted]:
    """`stop_port`: `none`, `open`, or `blocked`: it is said to be there and takes no connection."""
    service = Scripted(answers={**(answers or {})})
    with _port_of(service, stop_port) as port:
        service.answers["stop"] = service.answers["stop"] | {"port": port}
        with _serving(service.app(port, behind_proxy)) as url:
            service.url = url
            try:
                yield service
            finally:
                service.close()


@contextmanager
def _port_of(service: Scripted, stop_port: str) -> Iterator[int | None]:
    if stop_port == "open":
        with _serving(service.stop_process()) as url:
            yield int(url.rpartition(":")[2])
    elif stop_port == "blocked":  # as a firewall does: packets are dropped, so nobody says no
        with socket.create_server(("127.0.0.1", 0), backlog=0) as server, socket.socket() as first:
            first.connect(server.getsockname())  # the queue is full
            yield server.getsockname()[1]
    else:
        yield None


@contextmanager
def _serving(app: ASGIApp) -> Iterator[str]:
    config = uvicorn.Config(app, port=0, log_level="error", timeout_graceful_shutdown=1, ws="websockets-sansio")
    server = uvicorn.Server(config)
    listener = socket.create_server(("127.0.0.1", 0))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    try:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join()
        listener.close()
