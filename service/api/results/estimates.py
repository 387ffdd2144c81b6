"""Estimate revisions of a campaign; append-only, one for every identified sweep."""

from fastapi import APIRouter

from service.api.dependencies import After, ApplicationOf, Id, Limit, Page
from service.store.documents import EstimateDocument

router = APIRouter(prefix="/campaigns/{campaign_id}/estimates", tags=["estimates"])


@router.get("")
def list_estimates(
    campaign_id: Id, application: ApplicationOf, after: After = 0, limit: Limit = 50
) -> Page[EstimateDocument]:
    """Revisions, oldest first; `after` is a revision."""
    application.store.campaign(campaign_id)
    estimates = application.store.estimates(campaign_id, after, limit)
    return Page(items=estimates, next=estimates[-1].revision if len(estimates) == limit else None)


@router.get("/latest")
def get_latest_estimate(campaign_id: Id, application: ApplicationOf) -> EstimateDocument:
    """The newest revision; 404 until the first sweep is identified."""
    return application.store.estimate(campaign_id)


@router.get("/{revision}")
def get_estimate(campaign_id: Id, revision: Id, application: ApplicationOf) -> EstimateDocument:
    return application.store.estimate(campaign_id, revision)
