"""Long computations over many stored campaigns: start, progress and cancellation. Nothing moves."""

from typing import Annotated, Literal

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from service.store.access.permissions import LOCAL
from service.store.documents import LARGEST_ID
from service.store.plant import BatchDocument, BatchEntry, BatchEstimate
from service.web.api.dependencies import After, ApplicationOf, Id, Limit, Page, page, who_asks
from service.web.api.idempotent import IdempotentRoute

router = APIRouter(prefix="/jobs", tags=["jobs"], route_class=IdempotentRoute)

Number = Annotated[int, Field(ge=1, le=LARGEST_ID)]


class WantedJob(BaseModel):
    """`campaigns` null: all campaigns of this machine that are over and have an identified sweep."""

    model_config = ConfigDict(extra="forbid")
    kind: Literal["reidentify"] = "reidentify"
    campaigns: tuple[Number, ...] | None = Field(default=None, min_length=1, max_length=10_000)


@router.post("", status_code=202)
async def add_job(wanted: WantedJob, request: Request, response: Response, application: ApplicationOf) -> BatchDocument:
    """Identify stored campaigns again, with this version and the present models of the robots. Returns immediately.

    Stored estimates do not change; the results belong to the job. The job has a lower priority than all other work.
    Events of the kind `batch` report its progress.
    """
    by = who_asks(request, application) or LOCAL
    job = await application.own.batches.request(wanted.campaigns, by)
    response.headers["Location"] = str(request.url_for("get_job", job_id=job.id))
    return job


@router.get("")
def list_jobs(application: ApplicationOf, after: After = 0, limit: Limit = 50) -> Page[BatchDocument]:
    """Jobs of all machines of the plant."""
    return page(application.batches.batches(after, limit), limit)


@router.get("/{job_id}")
def get_job(job_id: Id, application: ApplicationOf) -> BatchDocument:
    return application.batches.batch(job_id)


@router.post("/{job_id}/cancel")
async def cancel_job(job_id: Id, application: ApplicationOf) -> BatchDocument:
    """Cancel the rest of the job. Computed results are kept; a job that is over does not change."""
    return await application.own.batches.cancel(job_id)


@router.get("/{job_id}/results")
def list_job_results(job_id: Id, application: ApplicationOf, after: After = 0, limit: Limit = 50) -> Page[BatchEntry]:
    """Results by campaign, without the estimates; `after` is the number of a campaign."""
    return page(application.batches.results(job_id, after, limit), limit, "campaign_id")


@router.get("/{job_id}/results/{campaign_id}")
def get_job_result(job_id: Id, campaign_id: Id, application: ApplicationOf) -> BatchEstimate:
    """The new estimate of one campaign."""
    return application.batches.result(job_id, campaign_id)
