"""Selects the estimate that is the initial rigid model of a diagnosis."""

from collections.abc import Sequence
from enum import Enum

import structlog

from service.formats.export.started_robot import started_from
from service.model.errors import BadInput
from service.model.results.estimate import Estimate
from service.planning.campaigns.linked import campaign_beside
from service.store.diagnoses import DiagnosisStore
from service.store.documents import CampaignState, EstimateOf, NewDiagnosis
from service.store.store import Store

_WHOLE = (CampaignState.COMPLETED, CampaignState.ABORTED)  # there will be no further revision

_log = structlog.get_logger(__name__)


class Start(Enum):
    """Requested start of a diagnosis: the latest estimate of the robot, if there is one, or CAD."""

    ESTIMATE = "estimate"
    CAD = "cad"


def latest_estimate(store: Store, diagnoses: DiagnosisStore, new: NewDiagnosis) -> EstimateOf | None:
    """The latest estimate of the robot from a finished campaign that is not part of the evidence; None: there is none.

    An estimate from the sweeps of the diagnosis would use the same data twice. One measured with a test mass is not
    of the robot alone. A stored estimate that does not fit the robot is skipped, with an entry in the log. One that
    leaves J of a diagnosed axis open, such as a daily check of one pose, is used only if there is no other: it may
    contain the change that is to be found, and knows little else.
    """
    incomplete: EstimateOf | None = None
    robot = store.robot(new.robot_id).build()
    every = store.estimated(new.robot_id)
    weighed = diagnoses.masses([one.campaign_id for one in every])
    for one in every:
        campaign = store.campaign(one.campaign_id)
        if campaign.state not in _WHOLE:
            continue
        beside = campaign_beside(store, campaign)
        used = {one.campaign_id, one.campaign_id if beside is None else beside.id}
        if used & {*new.campaigns, *weighed}:
            continue
        estimate = store.estimate(one.campaign_id, one.revision)
        try:
            started_from(robot, estimate.document, one.name, one.name)
            content = estimate.content
        except BadInput as error:
            _log.info("estimate_passed_over", campaign=one.campaign_id, revision=one.revision, reason=str(error))
            continue
        if _knows_inertia(content, new.axes):
            return one
        incomplete = incomplete or one
    return incomplete


def _knows_inertia(estimate: Estimate, joints: Sequence[str]) -> bool:
    """Whether the estimate states a confidence of J for each of these joints."""
    axes = [estimate.axes.get(joint) for joint in joints]
    return all(axis is not None and axis.confidence_percent is not None for axis in axes)
