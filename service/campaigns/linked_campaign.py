"""The campaign whose sweeps are combined with the trajectories of another campaign: named by the plan of the latter."""

from service.errors import BadInput, NotFound
from service.store.documents import CampaignDocument
from service.store.store import Store


def campaign_beside(store: Store, campaign: CampaignDocument) -> CampaignDocument | None:
    """The linked campaign; None if the plan names none, or without a plan."""
    if campaign.plan_id is None:
        return None
    request = store.plan(campaign.plan_id).document.get("request")
    named = request.get("sweeps") if isinstance(request, dict) else None
    return store.campaign(named) if isinstance(named, int) else None


def check_beside(store: Store, campaign_id: int, robot_id: int) -> None:
    """BadInput (field `sweeps`) if the campaign does not exist, or is of another robot."""
    try:
        campaign = store.campaign(campaign_id)
    except NotFound as error:
        raise BadInput("sweeps", str(error)) from None
    if campaign.robot_id != robot_id:
        raise BadInput("sweeps", f"campaign {campaign_id} measured robot {campaign.robot_id}, not robot {robot_id}")
