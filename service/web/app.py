"""The web application: API and operator's page."""

from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from importlib.metadata import version
from typing import cast

from fastapi import APIRouter, FastAPI
from fastapi.routing import APIRoute
from starlette.middleware.cors import CORSMiddleware

from service.machine.stop_process.handle import StopProcess
from service.process.settings import Settings
from service.report.html import makes_pdf
from service.web.api import (
    bundles,
    campaigns,
    diagnoses,
    drives,
    live,
    login,
    metrics,
    oidc,
    pairs,
    plans,
    results,
    stop,
)
from service.web.api.access import Access, AuditMiddleware, Guesses, ReadOnlyService
from service.web.api.dependencies import EPOCH, Arrival
from service.web.api.gate import BUNDLE_LIMIT, ROBOT_LIMIT, Gate, Logged
from service.web.api.login import PasswordCheck
from service.web.api.oidc import open_oidc
from service.web.api.openapi import DeclaredApi
from service.web.api.problem import Problem, install_problem_handlers
from service.web.api.route_roles import API, Permissions, allow
from service.web.application import Application, open_application
from service.web.hmi.pages import add_pages


def create_app(settings: Settings, hosts: Sequence[str] = (), stop_process: StopProcess | None = None) -> FastAPI:
    """The FastAPI application; its lifespan owns the `Application`. `hosts`: accepted host names, empty: any.

    `stop_process` is already running and belongs to the caller.
    """
    routers = (
        plans.robot_routes,
        plans.plan_routes,
        plans.picture_routes,
        plans.approval_routes,
        campaigns.campaign_routes,
        plans.ahead_routes,
        campaigns.sweep_routes,
        results.estimate_routes,
        results.report_routes,
        results.model_file_routes,
        diagnoses.diagnosis_routes,
        results.fleet_routes,
        results.job_routes,
        pairs.payload_routes,
        diagnoses.model_routes,
        bundles.router,
        live.event_routes,
        live.live_routes,
        drives.drive_routes,
        drives.machine_routes,
        stop.router,
        login.audit_routes,
        login.me_routes,
        login.login_routes,
        oidc.router,
        metrics.health_routes,
    )
    app = DeclaredApi(
        title="sweepid",
        version=version("sweepid"),
        summary="Measures the inertia of a robot's axes through its own drives",
        lifespan=_lifespan,
        openapi_url=f"{API}/openapi.json",
        docs_url=None,  # those pages load scripts from the internet
        redoc_url=None,
        generate_unique_id_function=_operation_id,
        responses={"default": {"model": Problem, "description": "Problem details (RFC 9457)"}},
    )
    app.state.settings = settings
    app.state.stop_process = stop_process
    api = APIRouter(prefix=API)
    for router in routers:
        api.include_router(router)
    app.include_router(api)
    app.include_router(metrics.metric_routes)
    of_api = len(app.routes)
    add_pages(app, None if stop_process is None else stop_process.port, makes_pdf, settings.behind_proxy)
    for page in app.routes[of_api:]:  # public files without data
        allow(None)(cast("APIRoute", page).endpoint)
    app.state.permissions = permissions = Permissions(app.routes)
    install_problem_handlers(app)
    limits = {f"{API}{bundles.BUNDLES}": BUNDLE_LIMIT, f"{API}{plans.robot_routes.prefix}": ROBOT_LIMIT}
    guesses = Guesses(settings.wrong_keys)
    app.state.password_check = PasswordCheck(guesses, settings.wrong_keys)
    app.state.oidc = open_oidc(settings.oidc, guesses)
    if settings.no_machine:
        app.add_middleware(ReadOnlyService)
    app.add_middleware(
        Access, login=settings.login, guesses=guesses, permissions=permissions
    )  # the last one handles a request first
    app.add_middleware(
        Gate, hosts=hosts, stop_path=f"{API}{stop.router.prefix}", limits=limits, origins=settings.cors_origins
    )
    app.add_middleware(AuditMiddleware, permissions=permissions)
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


def _application_of(app: FastAPI) -> Application | None:
    """None outside of its lifespan."""
    return getattr(app.state, "application", None)


def end_streams(app: FastAPI) -> None:
    """End all streams without an end (event streams, live samples), so that the server can shut down."""
    if (application := _application_of(app)) is not None:
        application.feed.close()
        application.hub.close()


async def end_motion(app: FastAPI) -> None:
    """Bring the machine to a final standstill, before the service waits for anything."""
    if (application := _application_of(app)) is not None and application.cell is not None:
        application.machine.end("the service ended")
        await application.runner.close()


def halt(app: FastAPI, why: str) -> None:
    """Stop every axis; no motion is possible afterwards. `why`: reason for the end of the service."""
    if (application := _application_of(app)) is not None and application.cell is not None:
        application.machine.end(f"the service ended by {why}")


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncGenerator[None, None]:
    async with open_application(app.state.settings, app.state.stop_process) as application:
        app.state.application = application
        yield
        app.state.password_check.close()


def _operation_id(route: APIRoute) -> str:
    return route.name
