"""The initial analysis that a campaign uses: the one that its plan names."""

from service.errors import BadInput, NotFound
from service.results.analysis import Analyses
from service.store.documents import CampaignDocument
from service.store.store import Store


def analysis_behind(store: Store, campaign: CampaignDocument) -> Analyses:
    """The analysis by joint; {} for a campaign without plan, or if the plan names none."""
    if campaign.plan_id is None:
        return {}
    request = store.plan(campaign.plan_id).document.get("request")
    named = request.get("analysis") if isinstance(request, dict) else None
    return latest_analysis(store, named) if isinstance(named, int) else {}


def latest_analysis(store: Store, campaign_id: int) -> Analyses:
    """The result of a campaign of an initial analysis; BadInput (field `analysis`) if it has none."""
    try:
        found = store.estimate(campaign_id).content.analysis
    except NotFound as error:
        raise BadInput("analysis", str(error)) from None
    if not found:
        raise BadInput("analysis", f"campaign {campaign_id} has no noise runs or stepped sines that were identified")
    return found
