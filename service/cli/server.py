"""The process that owns the machine."""

import asyncio
import gc
import json
import logging
import logging.handlers
import os
import signal
import sys
from socket import socket
from types import FrameType

import structlog
import uvicorn
from fastapi import FastAPI
from starlette.types import Receive, Scope, Send

from drivers.errors import DriveError
from service import SweepidError
from service.machine.stop_process.handle import StopNotStarted, StopProcess
from service.process.logs import configure_logs
from service.process.settings import Settings
from service.store.access import LOCAL
from service.web.app import create_app, end_motion, end_streams, halt

_log = structlog.get_logger(__name__)


class HeldBack(logging.handlers.MemoryHandler):
    """Holds what is logged until `let_through`: of a start that fails for a known reason one line is enough."""

    def __init__(self) -> None:
        """To be made after `configure_logs`."""
        root = logging.getLogger()
        (written,) = root.handlers
        super().__init__(capacity=10**6, flushLevel=logging.CRITICAL + 1, target=written)
        root.handlers = [self]

    def let_through(self) -> None:
        """Write what was held, and from now on everything at once."""
        self.flush()
        self.flushLevel = logging.NOTSET

    def drop(self) -> None:
        """Forget what was held, and what else is said of this start: what is closed after it speaks of it as well."""
        self.buffer.clear()
        self.setTarget(logging.NullHandler())


def run_service(settings: Settings) -> None:
    """Serve until a signal ends it; one JSON line with the address on stdout once it is ready."""
    settings.check()
    configure_logs(settings.log_level)
    logs = HeldBack()
    # s; with the default of 5 ms a busy thread delays the thread of the set-points by more than a cycle
    sys.setswitchinterval(1e-3)
    if not settings.answers_to:
        _log.warning("answers_to_any_host_name", host=settings.host, setting="allowed_hosts")
    if not settings.login:
        _log.warning("no_login", actor=LOCAL, rights="all", host=settings.host, setting="login")
    # uvicorn raises the signal that ended it once more when all is closed; that is then a clean end
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _end)
    try:
        if settings.no_machine:
            _serve(settings, None, logs)
            return
        with StopProcess(settings.drive, settings.host, settings.stop_listens_at, settings.tls) as stop_process:
            _serve(settings, stop_process, logs)
    except StopNotStarted:
        logs.drop()
        raise
    finally:
        logs.let_through()


def _serve(settings: Settings, stop_process: StopProcess | None, logs: HeldBack) -> None:
    gc.freeze()  # of the modules; again below
    app = create_app(settings, settings.answers_to, stop_process)
    started = _Startup(app)
    certificate, key = settings.tls or (None, None)
    server = _Server(
        app,
        stop_process,
        logs,
        uvicorn.Config(
            started,
            host=settings.host,
            port=settings.port,
            lifespan="on",
            log_config=None,
            access_log=False,
            timeout_graceful_shutdown=3,  # s for requests under way
            ws="websockets-sansio",
            proxy_headers=settings.behind_proxy,  # by default uvicorn believes whoever calls from this computer
            forwarded_allow_ips=[str(network) for network in settings.trusted_proxies],
            ssl_certfile=certificate,
            ssl_keyfile=key,
            headers=[] if certificate is None else [("Strict-Transport-Security", "max-age=31536000")],
        ),
    )
    try:
        asyncio.run(server.serve())
    except SystemExit as ended:
        if isinstance(started.error, SweepidError | DriveError):
            logs.drop()
            raise started.error from None  # uvicorn has only logged it
        if ended.code:
            if started.error is None:
                logs.drop()
            reason = _reason(started.error) or f"cannot listen at {settings.host}:{settings.port}"
            raise SweepidError(f"the service did not start: {reason}") from None
        raise


def _reason(error: Exception | None) -> str:
    """The first line of an error, or its kind where it says nothing."""
    if error is None:
        return ""
    said = str(error).partition("\n")[0]
    return said if isinstance(error, OSError) else f"{type(error).__name__}: {said}"


class _Startup:
    """The application as the server calls it, and why it did not start: the server only logs that."""

    def __init__(self, app: FastAPI) -> None:
        self._app = app
        self.error: Exception | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await self._app(scope, receive, send)
        except Exception as error:
            if scope["type"] == "lifespan":
                self.error = error
            raise


class _Server(uvicorn.Server):
    """Tells when it is ready. Told to end, it stops the machine before it waits for anything."""

    def __init__(self, app: FastAPI, stop_process: StopProcess | None, logs: HeldBack, config: uvicorn.Config) -> None:
        super().__init__(config)
        self._app, self._stop_process, self._logs = app, stop_process, logs

    async def startup(self, sockets: list[socket] | None = None) -> None:
        await super().startup(sockets)
        if self.started:
            gc.freeze()  # these objects live until the end; a full collection of them blocks all threads for 0.1 s
            self._logs.let_through()
            self._loop = asyncio.get_running_loop()
            if self._stop_process is not None:
                self._stop_process.watch_signals()
            hang_up = getattr(signal, "SIGHUP", None)  # the terminal is gone
            if hang_up is not None and signal.getsignal(hang_up) is not signal.SIG_IGN:  # as under nohup
                signal.signal(hang_up, self.handle_exit)
            port = self.servers[0].sockets[0].getsockname()[1]
            host = f"[{self.config.host}]" if ":" in self.config.host else self.config.host
            scheme = "https" if self.config.is_ssl else "http"
            ready = {"ready": True, "url": f"{scheme}://{host}:{port}", "port": port, "pid": os.getpid()}
            sys.stdout.write(
                json.dumps(ready | {"stop_port": None if self._stop_process is None else self._stop_process.port})
                + "\n"
            )
            sys.stdout.flush()

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """The stop process has seen the signal before; this is the service's own word to the drives."""
        super().handle_exit(sig, frame)
        self._loop.call_soon_threadsafe(
            self._halt, signal.Signals(sig).name
        )  # not here: the loop may hold the lock of the bus

    async def shutdown(self, sockets: list[socket] | None = None) -> None:
        halting = asyncio.create_task(end_motion(self._app), name="end of motion")
        end_streams(self._app)
        await asyncio.wait([halting])
        await super().shutdown(sockets)
        await halting  # an error of its own

    def _halt(self, name: str) -> None:
        halt(self._app, name)
        if self._stop_process is not None:
            self._stop_process.taken_over()


def _end(number: int, frame: FrameType | None) -> None:
    raise SystemExit(0)
