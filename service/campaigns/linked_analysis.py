"""Which initial analysis stands behind a campaign: the one that its plan names."""

from service.errors import BadInput, NotFound
from service.results.analysis import Analyses
from service.store.documents import CampaignDocument
from service.store.store import Store


def analysis_behind(store: Store, campaign: CampaignDocument) -> Analyses:
    """By joint; {} for a campaign whose plan names none, or that has no plan."""
    if campaign.plan_id is None:
        return {}
    request = store.plan(campaign.plan_id).document.get("request")
    named = request.get("analysis") if isinstance(request, dict) else None
    return latest_analysis(store, named) if isinstance(named, int) else {}


def latest_analysis(store: Store, campaign_id: int) -> Analyses:
    """The initial analysis that a campaign came to; BadInput (field `analysis`) if it has none."""
    try:
        found = store.estimate(campaign_id).content.analysis
    except NotFound as error:
        raise BadInput("analysis", str(error)) from None
    if not found:
        raise BadInput("analysis", f"campaign {campaign_id} has no noise runs or stepped sines that were identified")
    return found
