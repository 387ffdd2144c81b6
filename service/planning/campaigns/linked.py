"""The campaigns that the plan of a campaign names: an initial analysis, and the sweeps to combine with trajectories."""

from typing import Literal

from service.model.errors import BadInput, NotFound
from service.model.results.estimate import Analyses
from service.store.documents import CampaignDocument
from service.store.store import Store


def _named(store: Store, campaign: CampaignDocument, field: Literal["analysis", "sweeps"]) -> int | None:
    """The campaign that this field of the plan's request names; None without a plan, too."""
    request = None if campaign.plan_id is None else store.plan(campaign.plan_id).document.get("request")
    named = request.get(field) if isinstance(request, dict) else None
    return named if isinstance(named, int) else None


def campaign_beside(store: Store, campaign: CampaignDocument) -> CampaignDocument | None:
    """The campaign whose sweeps are combined with the trajectories of this one; None if there is none."""
    named = _named(store, campaign, "sweeps")
    return None if named is None else store.campaign(named)


def check_beside(store: Store, campaign_id: int, robot_id: int) -> None:
    """BadInput (field `sweeps`) if the campaign does not exist, or is of another robot."""
    try:
        campaign = store.campaign(campaign_id)
    except NotFound as error:
        raise BadInput("sweeps", str(error)) from None
    if campaign.robot_id != robot_id:
        raise BadInput("sweeps", f"campaign {campaign_id} measured robot {campaign.robot_id}, not robot {robot_id}")


def analysis_behind(store: Store, campaign: CampaignDocument) -> Analyses:
    """The initial analysis that a campaign uses, by joint; {} if there is none."""
    named = _named(store, campaign, "analysis")
    return {} if named is None else latest_analysis(store, named)


def latest_analysis(store: Store, campaign_id: int) -> Analyses:
    """The result of a campaign of an initial analysis; BadInput (field `analysis`) if it has none."""
    try:
        found = store.estimate(campaign_id).content.analysis
    except NotFound as error:
        raise BadInput("analysis", str(error)) from None
    if not found:
        raise BadInput("analysis", f"campaign {campaign_id} has no noise runs or stepped sines that were identified")
    return found
