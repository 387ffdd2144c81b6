"""Estimates, diagnoses, model revisions and model files."""

from collections.abc import Callable
from datetime import UTC, datetime
from enum import StrEnum
from functools import partial
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field
from starlette.concurrency import run_in_threadpool

from service import NoPdf
from service.formats.export import model_files, model_of
from service.formats.export.sheets.making import sheet
from service.formats.export.sheets.text import as_markdown
from service.identification.fleet.document import Fleet
from service.identification.fleet.survey import FleetRules
from service.jobs.reporting import Reporting, of_fleet
from service.jobs.work import Work, Written
from service.jobs.worker import Worker
from service.planning.campaigns.stored_results import campaign_beside
from service.planning.compiled_plan import plan_of
from service.planning.plan import PlanDocument
from service.report.html import Form
from service.store.access import LOCAL, Role
from service.store.documents import LARGEST_ID, EstimateDocument
from service.store.plant import BatchDocument, BatchEntry, BatchEstimate
from service.web.api.dependencies import (
    After,
    ApplicationOf,
    BatchesOf,
    CallerOf,
    FleetOf,
    Id,
    IdempotentRoute,
    Limit,
    Page,
    ReidentifyingOf,
    SettingsOf,
    StoreOf,
    WorkerOf,
    download,
    media,
    page,
)
from service.web.api.route_roles import allow

estimate_routes = APIRouter(prefix="/campaigns/{campaign_id}/estimates", tags=["estimates"])
model_file_routes = APIRouter(prefix="/campaigns/{campaign_id}", tags=["estimates"])
report_routes = APIRouter(tags=["reports"])
fleet_routes = APIRouter(prefix="/fleet", tags=["fleet"])
job_routes = APIRouter(prefix="/jobs", tags=["jobs"], route_class=IdempotentRoute)


@estimate_routes.get("")
@allow(Role.VIEWER)
def list_estimates(campaign_id: Id, store: StoreOf, after: After = 0, limit: Limit = 50) -> Page[EstimateDocument]:
    """Revisions, oldest first; `after` is the number of a revision."""
    store.campaign(campaign_id)
    return page(store.estimates(campaign_id, after, limit), limit, "revision")


class Confidence(BaseModel):
    """For one revision, after its sweep: the largest std of J over the workspace by joint, percent; null: unknown."""

    revision: int
    sweep: int
    percent: dict[str, float | None]


class Convergence(BaseModel):
    """The confidence of each revision. `wanted`: percent; null if the plan requires all sweeps."""

    wanted: float | None
    revisions: tuple[Confidence, ...]


@estimate_routes.get("/convergence")
@allow(Role.VIEWER)
def get_convergence(campaign_id: Id, store: StoreOf) -> Convergence:
    """In the order of the revisions; empty until the first sweep is identified."""
    campaign = store.campaign(campaign_id)
    plan = None if campaign.plan_id is None else plan_of(store.plan(campaign.plan_id))
    joints = list(dict.fromkeys(sweep.spec.axis for sweep in store.sweeps(campaign_id)))
    return Convergence(
        wanted=plan.request.confidence if isinstance(plan, PlanDocument) else None,
        revisions=tuple(
            Confidence.model_validate(
                {"revision": revision, "sweep": sweep, "percent": dict(zip(joints, percent, strict=True))}
            )
            for revision, sweep, *percent in store.confidences(campaign_id, joints)
        ),
    )


@estimate_routes.get("/latest")
@allow(Role.VIEWER)
def get_latest_estimate(campaign_id: Id, store: StoreOf) -> EstimateDocument:
    """The newest revision; 404 until the first sweep is identified."""
    return store.estimate(campaign_id)


@estimate_routes.get("/{revision}")
@allow(Role.VIEWER)
def get_estimate(campaign_id: Id, revision: Id, store: StoreOf) -> EstimateDocument:
    return store.estimate(campaign_id, revision)


class ModelEnding(StrEnum):
    """Selected by the file extension: URDF, MJCF (MuJoCo), or all parameters as YAML."""

    URDF = "urdf"
    MJCF = "xml"
    YAML = "yaml"


@model_file_routes.get(
    "/model.{ending}",
    response_class=Response,
    responses={
        200: {
            "content": {
                "application/xml": {"schema": {"type": "string"}},
                "application/yaml": {"schema": {"type": "object"}},
            }
        }
    },
)
@allow(Role.VIEWER)
def get_model(campaign_id: Id, ending: ModelEnding, store: StoreOf) -> Response:
    """404 until the first sweep is identified; 422 while no sweep gives an inertia."""
    robot = store.robot(store.campaign(campaign_id).robot_id).build()
    estimate = store.estimate(campaign_id)
    model = model_of(robot, estimate.content, f"estimate {estimate.revision} of campaign {campaign_id}")
    name = f"model.{ending.value}"
    media_type = "application/yaml" if ending is ModelEnding.YAML else "application/xml"
    return download(model_files(model)[name], media_type, f"campaign-{campaign_id}-{name}")


@model_file_routes.get(
    "/sheet.md", response_class=Response, responses=media("text/markdown", schema={"type": "string"})
)
@allow(Role.VIEWER)
def get_sheet(campaign_id: Id, store: StoreOf) -> Response:
    """The values that controls take. 404 until the first sweep is identified; 422 while no sweep gives an inertia."""
    campaign = store.campaign(campaign_id)
    robot, estimate = store.robot(campaign.robot_id).build(), store.estimate(campaign_id)
    beside = campaign_beside(store, campaign)
    sweeps = [*(() if beside is None else store.sweeps(beside.id)), *store.sweeps(campaign_id)]
    poses = {sweep.spec.id: sweep.spec.pose for sweep in sweeps}
    made = sheet(robot, estimate.content, f"estimate {estimate.revision} of campaign {campaign_id}", poses)
    return download(as_markdown(made), "text/markdown", f"campaign-{campaign_id}-sheet.md")


class ReportFile(StrEnum):
    """Selected by the file extension: PDF (A4), or all tables of the report, by section, as text in JSON."""

    PDF = "pdf"
    JSON = "json"

    @property
    def form(self) -> Form:
        return self.value


HTML = media("text/html", schema={"type": "string"})
_TABLES = {
    "title": "Inertias of the robot max100-class",
    "tables": [{"section": "Estimate", "head": ["sweep", "J, kg m²"], "rows": [["0001", "642"]]}],
}
FILES: dict[int | str, dict[str, Any]] = {
    200: {
        "content": {
            "application/pdf": {"schema": {"type": "string", "format": "binary"}},
            "application/json": {"schema": {"type": "object"}, "examples": {"answer": {"value": _TABLES}}},
        }
    }
}


async def _reporting(application: ApplicationOf) -> Reporting:
    return Reporting(application.store, application.diagnoses, application.checks, application.files)


ReportingOf = Annotated[Reporting, Depends(_reporting)]


async def _drawn(worker: Worker, job: Callable[[], Work[Written]]) -> str | bytes:
    """The report that the worker draws. NoPdf if PDF is not available."""
    written = await worker.run(await run_in_threadpool(job))
    if isinstance(written, NoPdf):
        raise written
    return written


@report_routes.get("/campaigns/{campaign_id}/report", response_class=Response, responses=HTML)
@allow(Role.VIEWER)
async def get_campaign_report(campaign_id: Id, reporting: ReportingOf, worker: WorkerOf) -> Response:
    """One HTML file of the latest estimate; it needs no network. 409 until a sweep is identified."""
    return Response(await _drawn(worker, partial(reporting.job, campaign_id, "html")), media_type="text/html")


@report_routes.get("/campaigns/{campaign_id}/report.{ending}", response_class=Response, responses=FILES)
@allow(Role.VIEWER)
async def get_campaign_report_file(
    campaign_id: Id, ending: ReportFile, reporting: ReportingOf, worker: WorkerOf
) -> Response:
    """409 until a sweep is identified; 501 if the service cannot make PDF."""
    written = await _drawn(worker, partial(reporting.job, campaign_id, ending.form))
    return file_of(written, ending, f"campaign-{campaign_id}")


@report_routes.get("/diagnoses/{diagnosis_id}/report.html", response_class=Response, responses=HTML)
@allow(Role.VIEWER)
async def get_diagnosis_report(diagnosis_id: Id, reporting: ReportingOf, worker: WorkerOf) -> Response:
    """One HTML file; it needs no network. 409 until the diagnosis is done."""
    return Response(await _drawn(worker, partial(reporting.of_diagnosis, diagnosis_id, "html")), media_type="text/html")


@report_routes.get("/diagnoses/{diagnosis_id}/report.{ending}", response_class=Response, responses=FILES)
@allow(Role.VIEWER)
async def get_diagnosis_report_file(
    diagnosis_id: Id, ending: ReportFile, reporting: ReportingOf, worker: WorkerOf
) -> Response:
    """409 until the diagnosis is done; 501 if the service cannot make PDF."""
    written = await _drawn(worker, partial(reporting.of_diagnosis, diagnosis_id, ending.form))
    return file_of(written, ending, f"diagnosis-{diagnosis_id}")


def file_of(written: str | bytes, ending: ReportFile, name: str) -> Response:
    """The answer with the file of a report."""
    return download(written, f"application/{ending.value}", f"{name}-report.{ending.value}")


OfType = Annotated[
    str | None, Query(alias="type", min_length=1, max_length=200, description="name of the robots; default: all types")
]


def _fleet_now(history: FleetOf, settings: SettingsOf, name: OfType = None) -> Fleet:
    """The present state of the robots of one type, or of all; blocks. NotFound."""
    rules = FleetRules(settings.fleet_false_alarms, settings.fleet_campaigns, settings.remeasure_days)
    return history.fleet(rules, datetime.now(UTC), name)


FleetNow = Annotated[Fleet, Depends(_fleet_now)]


@fleet_routes.get("")
@allow(Role.VIEWER)
def get_fleet(fleet: FleetNow) -> Fleet:
    """Uses the newest estimate of each finished campaign, of all machines of the plant. 404 for an unknown type.

    Campaigns are compared in their common poses. Excluded are initial analyses, trajectories, and the experiments of a
    diagnosis, which may have a test mass on the robot.
    """
    return fleet


@fleet_routes.get("/report", response_class=Response, responses=HTML)
@allow(Role.VIEWER)
async def get_fleet_report(fleet: FleetNow, worker: WorkerOf) -> Response:
    """One HTML file with a control chart for each axis; it needs no network."""
    return Response(await _drawn(worker, partial(of_fleet, fleet, "html")), media_type="text/html")


@fleet_routes.get("/report.{ending}", response_class=Response, responses=FILES)
@allow(Role.VIEWER)
async def get_fleet_report_file(ending: ReportFile, fleet: FleetNow, worker: WorkerOf) -> Response:
    """501 if the service cannot make PDF."""
    return file_of(await _drawn(worker, partial(of_fleet, fleet, ending.form)), ending, "fleet")


Number = Annotated[int, Field(ge=1, le=LARGEST_ID)]


class WantedJob(BaseModel):
    """`campaigns` null: all campaigns of this machine that are over and have an identified sweep."""

    model_config = ConfigDict(extra="forbid")
    kind: Literal["reidentify"] = "reidentify"
    campaigns: tuple[Number, ...] | None = Field(default=None, min_length=1, max_length=10_000)


@job_routes.post("", status_code=202)
@allow(Role.ENGINEER)
async def add_job(
    wanted: WantedJob, request: Request, response: Response, reidentifying: ReidentifyingOf, by: CallerOf
) -> BatchDocument:
    """Identify stored campaigns again, with this version and the present models of the robots. Returns immediately.

    Stored estimates do not change; the results belong to the job. The job has a lower priority than all other work.
    Events of the kind `batch` report its progress.
    """
    by = by or LOCAL
    job = await reidentifying.request(wanted.campaigns, by)
    response.headers["Location"] = str(request.url_for("get_job", job_id=job.id))
    return job


@job_routes.get("")
@allow(Role.VIEWER)
def list_jobs(batches: BatchesOf, after: After = 0, limit: Limit = 50) -> Page[BatchDocument]:
    """Jobs of all machines of the plant."""
    return page(batches.batches(after, limit), limit)


@job_routes.get("/{job_id}")
@allow(Role.VIEWER)
def get_job(job_id: Id, batches: BatchesOf) -> BatchDocument:
    return batches.batch(job_id)


@job_routes.post("/{job_id}/cancel")
@allow(Role.ENGINEER)
async def cancel_job(job_id: Id, reidentifying: ReidentifyingOf) -> BatchDocument:
    """Cancel the rest of the job. Computed results are kept; a job that is over does not change."""
    return await reidentifying.cancel(job_id)


@job_routes.get("/{job_id}/results")
@allow(Role.VIEWER)
def list_job_results(job_id: Id, batches: BatchesOf, after: After = 0, limit: Limit = 50) -> Page[BatchEntry]:
    """Results by campaign, without the estimates; `after` is the number of a campaign."""
    return page(batches.results(job_id, after, limit), limit, "campaign_id")


@job_routes.get("/{job_id}/results/{campaign_id}")
@allow(Role.VIEWER)
def get_job_result(job_id: Id, campaign_id: Id, batches: BatchesOf) -> BatchEstimate:
    """The new estimate of one campaign."""
    return batches.result(job_id, campaign_id)
