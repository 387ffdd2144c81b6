"""The report of a campaign: one page to read, print and keep."""

from fastapi import APIRouter, Response

from service.api.dependencies import ApplicationOf, Id

router = APIRouter(prefix="/campaigns/{campaign_id}/report", tags=["reports"])


@router.get(
    "",
    response_class=Response,
    responses={200: {"content": {"text/html": {"schema": {"type": "string"}}}}},
)
async def get_campaign_report(campaign_id: Id, application: ApplicationOf) -> Response:
    """One file that needs no network, of the latest estimate. 409 until a sweep is identified."""
    return Response(await application.campaign_report(campaign_id), media_type="text/html")
