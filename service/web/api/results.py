"""Estimates, diagnoses, model revisions and model files."""

from enum import StrEnum
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from service.formats.export import model_files, model_of
from service.identification.fleet.document import Fleet
from service.planning.compiled_plan import plan_of
from service.planning.plan import PlanDocument
from service.report import Form
from service.store.access.permissions import LOCAL, Role
from service.store.documents import LARGEST_ID, EstimateDocument
from service.store.plant.batches import BatchDocument, BatchEntry, BatchEstimate
from service.web.api.dependencies import After, ApplicationOf, Id, Limit, Page, page, who_asks
from service.web.api.idempotent import IdempotentRoute
from service.web.api.permissions import allow

estimate_routes = APIRouter(prefix="/campaigns/{campaign_id}/estimates", tags=["estimates"])
model_file_routes = APIRouter(prefix="/campaigns/{campaign_id}", tags=["estimates"])
report_routes = APIRouter(tags=["reports"])
fleet_routes = APIRouter(prefix="/fleet", tags=["fleet"])
job_routes = APIRouter(prefix="/jobs", tags=["jobs"], route_class=IdempotentRoute)


@estimate_routes.get("")
@allow(Role.VIEWER)
def list_estimates(
    campaign_id: Id, application: ApplicationOf, after: After = 0, limit: Limit = 50
) -> Page[EstimateDocument]:
    """Revisions, oldest first; `after` is the number of a revision."""
    application.store.campaign(campaign_id)
    return page(application.store.estimates(campaign_id, after, limit), limit, "revision")


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
def get_convergence(campaign_id: Id, application: ApplicationOf) -> Convergence:
    """In the order of the revisions; empty until the first sweep is identified."""
    store = application.store
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
def get_latest_estimate(campaign_id: Id, application: ApplicationOf) -> EstimateDocument:
    """The newest revision; 404 until the first sweep is identified."""
    return application.store.estimate(campaign_id)


@estimate_routes.get("/{revision}")
@allow(Role.VIEWER)
def get_estimate(campaign_id: Id, revision: Id, application: ApplicationOf) -> EstimateDocument:
    return application.store.estimate(campaign_id, revision)


class ModelEnding(StrEnum):
    """Selected by the file extension: URDF, MJCF (MuJoCo), or all parameters as YAML."""

    URDF = "urdf"
    MJCF = "xml"
    YAML = "yaml"


_CONTENT = {"application/xml": {"schema": {"type": "string"}}, "application/yaml": {"schema": {"type": "object"}}}
_TYPES = {
    ModelEnding.URDF: "application/xml",
    ModelEnding.MJCF: "application/xml",
    ModelEnding.YAML: "application/yaml",
}


@model_file_routes.get(
    "/model.{ending}",
    response_class=Response,
    responses={200: {"content": _CONTENT}},
)
@allow(Role.VIEWER)
def get_model(campaign_id: Id, ending: ModelEnding, application: ApplicationOf) -> Response:
    """404 until the first sweep is identified; 422 while no sweep gives an inertia."""
    robot = application.store.robot(application.store.campaign(campaign_id).robot_id).build()
    estimate = application.store.estimate(campaign_id)
    model = model_of(robot, estimate.content, f"estimate {estimate.revision} of campaign {campaign_id}")
    name = f"model.{ending.value}"
    disposition = {"Content-Disposition": f'attachment; filename="campaign-{campaign_id}-{name}"'}
    return Response(model_files(model)[name], media_type=_TYPES[ending], headers=disposition)


class ReportFile(StrEnum):
    """Selected by the file extension: PDF (A4), or all tables of the report, by section, as text in JSON."""

    PDF = "pdf"
    JSON = "json"


HTML: dict[int | str, dict[str, Any]] = {200: {"content": {"text/html": {"schema": {"type": "string"}}}}}
_TABLE = {"section": "Estimate", "head": ["sweep", "J, kg m²"], "rows": [["0001", "642"]]}
_TABLES = {"title": "Inertias of the robot max100-class", "tables": [_TABLE]}
FILES: dict[int | str, dict[str, Any]] = {
    200: {
        "content": {
            "application/pdf": {"schema": {"type": "string", "format": "binary"}},
            "application/json": {"schema": {"type": "object"}, "examples": {"answer": {"value": _TABLES}}},
        }
    }
}
FORMS: dict[ReportFile, Form] = {ReportFile.PDF: "pdf", ReportFile.JSON: "json"}


@report_routes.get("/campaigns/{campaign_id}/report", response_class=Response, responses=HTML)
@allow(Role.VIEWER)
async def get_campaign_report(campaign_id: Id, application: ApplicationOf) -> Response:
    """One HTML file of the latest estimate; it needs no network. 409 until a sweep is identified."""
    return Response(await application.campaign_report(campaign_id, "html"), media_type="text/html")


@report_routes.get("/campaigns/{campaign_id}/report.{ending}", response_class=Response, responses=FILES)
@allow(Role.VIEWER)
async def get_campaign_report_file(campaign_id: Id, ending: ReportFile, application: ApplicationOf) -> Response:
    """409 until a sweep is identified; 501 if the service cannot make PDF."""
    written = await application.campaign_report(campaign_id, FORMS[ending])
    return file_of(written, ending, f"campaign-{campaign_id}")


@report_routes.get("/diagnoses/{diagnosis_id}/report.html", response_class=Response, responses=HTML)
@allow(Role.VIEWER)
async def get_diagnosis_report(diagnosis_id: Id, application: ApplicationOf) -> Response:
    """One HTML file; it needs no network. 409 until the diagnosis is done."""
    return Response(await application.diagnosis_report(diagnosis_id, "html"), media_type="text/html")


@report_routes.get("/diagnoses/{diagnosis_id}/report.{ending}", response_class=Response, responses=FILES)
@allow(Role.VIEWER)
async def get_diagnosis_report_file(diagnosis_id: Id, ending: ReportFile, application: ApplicationOf) -> Response:
    """409 until the diagnosis is done; 501 if the service cannot make PDF."""
    written = await application.diagnosis_report(diagnosis_id, FORMS[ending])
    return file_of(written, ending, f"diagnosis-{diagnosis_id}")


def file_of(written: str | bytes, ending: ReportFile, name: str) -> Response:
    """The answer with the file of a report."""
    disposition = {"Content-Disposition": f'attachment; filename="{name}-report.{ending.value}"'}
    return Response(written, media_type=f"application/{ending.value}", headers=disposition)


OfType = Annotated[
    str | None, Query(alias="type", min_length=1, max_length=200, description="name of the robots; default: all types")
]


@fleet_routes.get("")
@allow(Role.VIEWER)
def get_fleet(application: ApplicationOf, name: OfType = None) -> Fleet:
    """Uses the newest estimate of each finished campaign, of all machines of the plant. 404 for an unknown type.

    Campaigns are compared in their common poses. Excluded are initial analyses, trajectories, and the experiments of a
    diagnosis, which may have a test mass on the robot.
    """
    return application.fleet(name)


@fleet_routes.get("/report", response_class=Response, responses=HTML)
@allow(Role.VIEWER)
async def get_fleet_report(application: ApplicationOf, name: OfType = None) -> Response:
    """One HTML file with a control chart for each axis; it needs no network."""
    return Response(await application.fleet_report(name, "html"), media_type="text/html")


@fleet_routes.get("/report.{ending}", response_class=Response, responses=FILES)
@allow(Role.VIEWER)
async def get_fleet_report_file(ending: ReportFile, application: ApplicationOf, name: OfType = None) -> Response:
    """501 if the service cannot make PDF."""
    return file_of(await application.fleet_report(name, FORMS[ending]), ending, "fleet")


Number = Annotated[int, Field(ge=1, le=LARGEST_ID)]


class WantedJob(BaseModel):
    """`campaigns` null: all campaigns of this machine that are over and have an identified sweep."""

    model_config = ConfigDict(extra="forbid")
    kind: Literal["reidentify"] = "reidentify"
    campaigns: tuple[Number, ...] | None = Field(default=None, min_length=1, max_length=10_000)


@job_routes.post("", status_code=202)
@allow(Role.ENGINEER)
async def add_job(wanted: WantedJob, request: Request, response: Response, application: ApplicationOf) -> BatchDocument:
    """Identify stored campaigns again, with this version and the present models of the robots. Returns immediately.

    Stored estimates do not change; the results belong to the job. The job has a lower priority than all other work.
    Events of the kind `batch` report its progress.
    """
    by = who_asks(request, application) or LOCAL
    job = await application.own.batches.request(wanted.campaigns, by)
    response.headers["Location"] = str(request.url_for("get_job", job_id=job.id))
    return job


@job_routes.get("")
@allow(Role.VIEWER)
def list_jobs(application: ApplicationOf, after: After = 0, limit: Limit = 50) -> Page[BatchDocument]:
    """Jobs of all machines of the plant."""
    return page(application.batches.batches(after, limit), limit)


@job_routes.get("/{job_id}")
@allow(Role.VIEWER)
def get_job(job_id: Id, application: ApplicationOf) -> BatchDocument:
    return application.batches.batch(job_id)


@job_routes.post("/{job_id}/cancel")
@allow(Role.ENGINEER)
async def cancel_job(job_id: Id, application: ApplicationOf) -> BatchDocument:
    """Cancel the rest of the job. Computed results are kept; a job that is over does not change."""
    return await application.own.batches.cancel(job_id)


@job_routes.get("/{job_id}/results")
@allow(Role.VIEWER)
def list_job_results(job_id: Id, application: ApplicationOf, after: After = 0, limit: Limit = 50) -> Page[BatchEntry]:
    """Results by campaign, without the estimates; `after` is the number of a campaign."""
    return page(application.batches.results(job_id, after, limit), limit, "campaign_id")


@job_routes.get("/{job_id}/results/{campaign_id}")
@allow(Role.VIEWER)
def get_job_result(job_id: Id, campaign_id: Id, application: ApplicationOf) -> BatchEstimate:
    """The new estimate of one campaign."""
    return application.batches.result(job_id, campaign_id)
