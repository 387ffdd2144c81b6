"""Estimate revisions of a campaign; append-only. Each identified sweep has one, except in large imports."""

from fastapi import APIRouter
from pydantic import BaseModel

from service.planning.compiled_plan import plan_of
from service.planning.documents import PlanDocument
from service.store.documents import EstimateDocument
from service.web.api.dependencies import After, ApplicationOf, Id, Limit, Page, page

router = APIRouter(prefix="/campaigns/{campaign_id}/estimates", tags=["estimates"])


@router.get("")
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


@router.get("/convergence")
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


@router.get("/latest")
def get_latest_estimate(campaign_id: Id, application: ApplicationOf) -> EstimateDocument:
    """The newest revision; 404 until the first sweep is identified."""
    return application.store.estimate(campaign_id)


@router.get("/{revision}")
def get_estimate(campaign_id: Id, revision: Id, application: ApplicationOf) -> EstimateDocument:
    return application.store.estimate(campaign_id, revision)
