"""The web application: API and operator's page."""

from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from importlib.metadata import version

from fastapi import APIRouter, FastAPI
from fastapi.routing import APIRoute
from starlette.middleware.cors import CORSMiddleware

from service.machine.stop_process.handle import StopProcess
from service.process.settings import Settings
from service.web.api import events, health, robots
from service.web.api.campaign import ahead, approvals, bundles, campaigns, pictures, plans, sweeps
from service.web.api.declared.application import DeclaredApi
from service.web.api.gate import BUNDLE_LIMIT, ROBOT_LIMIT, Gate
from service.web.api.logged import Logged
from service.web.api.machine import drives, live, machines, stop
from service.web.api.machine.arrival import EPOCH, Arrival
from service.web.api.metrics import route as metrics
from service.web.api.people import audit, login, me, oidc
from service.web.api.people.access import Access
from service.web.api.people.audit_middleware import AuditMiddleware
from service.web.api.people.oidc_login import open_oidc
from service.web.api.people.password_check import PasswordCheck
from service.web.api.people.rate_limit import Guesses
from service.web.api.problem import Problem, install_problem_handlers
from service.web.api.read_only import ReadOnly
from service.web.api.results import diagnoses, estimates, fleet, jobs, model_revisions, models, reports
from service.web.application import Application, open_application
from service.web.hmi.pages import add_pages

PREFIX = "/api/v1"
_ENDED = "the service ended"
_ROUTERS = (
    robots.router,
    plans.router,
    pictures.router,
    approvals.router,
    campaigns.router,
    ahead.router,
    sweeps.router,
    estimates.router,
    reports.router,
    models.router,
    diagnoses.router,
    fleet.router,
    jobs.router,
    model_revisions.router,
    bundles.router,
    events.router,
    live.router,
    drives.router,
    machines.router,
    stop.router,
    audit.router,
    me.router,
    login.router,
    oidc.router,
    health.router,
)


def create_app(settings: Settings, hosts: Sequence[str] = (), stop_process: StopProcess | None = None) -> FastAPI:
    """The FastAPI application; its lifespan owns the `Application`. `hosts`: accepted host names, empty: any.

    `stop_process` is already running and belongs to the caller.
    """
    app = DeclaredApi(
        title="sweepid",
        version=version("sweepid"),
        summary="Measures the inertia of a robot's axes through its own drives",
        lifespan=_lifespan,
        openapi_url=f"{PREFIX}/openapi.json",
        docs_url=None,  # those pages load scripts from the internet
        redoc_url=None,
        generate_unique_id_function=_operation_id,
        responses={"default": {"model": Problem, "description": "Problem details (RFC 9457)"}},
    )
    app.state.settings = settings
    app.state.stop_process = stop_process
    api = APIRouter(prefix=PREFIX)
    for router in _ROUTERS:
        api.include_router(router)
    app.include_router(api)
    app.include_router(metrics.router)
    add_pages(app, None if stop_process is None else stop_process.port, settings.behind_proxy)
    install_problem_handlers(app)
    limits = {f"{PREFIX}{bundles.BUNDLES}": BUNDLE_LIMIT, f"{PREFIX}{robots.router.prefix}": ROBOT_LIMIT}
    guesses = Guesses(settings.wrong_keys)
    app.state.password_check = PasswordCheck(guesses, settings.wrong_keys)
    app.state.oidc = open_oidc(settings.oidc, guesses)
    if settings.no_machine:
        app.add_middleware(ReadOnly)
    app.add_middleware(Access, login=settings.login, guesses=guesses)  # the last one handles a request first
    app.add_middleware(
        Gate, hosts=hosts, stop_path=f"{PREFIX}{stop.router.prefix}", limits=limits, origins=settings.cors_origins
    )
    app.add_middleware(AuditMiddleware)
    app.add_middleware(Logged)
    if settings.cors_origins:  # without cookies: other pages send keys
        app.add_middleware(
            CORSMiddleware,
            allow_origins=settings.cors_origins,
            allow_methods=("GET", "POST", "PUT", "DELETE"),
            allow_headers=("Authorization", "Content-Type", "If-Match", "Idempotency-Key", "Last-Event-ID", EPOCH),
            expose_headers=("ETag", "Location", "Retry-After"),
        )
    app.add_middleware(Arrival)
    return app


def end_streams(app: FastAPI) -> None:
    """End all streams without an end (event streams, live samples), so that the server can shut down."""
    application: Application | None = getattr(app.state, "application", None)
    if application is not None:
        application.feed.close()
        application.hub.close()


async def end_motion(app: FastAPI) -> None:
    """Bring the machine to a final standstill, before the service waits for anything."""
    application: Application | None = getattr(app.state, "application", None)
    if application is not None and application.cell is not None:
        application.machine.end(_ENDED)
        await application.runner.close()


def halt(app: FastAPI, why: str) -> None:
    """Stop every axis; no motion is possible afterwards. `why`: reason for the end of the service."""
    application: Application | None = getattr(app.state, "application", None)
    if application is not None and application.cell is not None:
        application.machine.end(f"{_ENDED} by {why}")


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncGenerator[None, None]:
    async with open_application(app.state.settings, app.state.stop_process) as application:
        app.state.application = application
        yield
        app.state.password_check.close()


def _operation_id(route: APIRoute) -> str:
    return route.name
