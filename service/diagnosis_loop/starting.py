"""From which estimate the rigid model of a diagnosis starts."""

from enum import Enum

import structlog

from service.campaigns.linked_campaign import campaign_beside
from service.diagnosis import started_from
from service.errors import BadInput
from service.store.diagnosis.diagnoses import DiagnosisStore
from service.store.diagnosis_documents import EstimateOf, NewDiagnosis
from service.store.documents import CampaignState
from service.store.store import Store

_WHOLE = (CampaignState.COMPLETED, CampaignState.ABORTED)  # no revision will follow

_log = structlog.get_logger(__name__)


class Start(Enum):
    """What a diagnosis is asked to start from: the robot's latest estimate, if there is one, or CAD."""

    ESTIMATE = "estimate"
    CAD = "cad"


def latest_estimate(store: Store, diagnoses: DiagnosisStore, new: NewDiagnosis) -> EstimateOf | None:
    """The robot's latest estimate of a campaign that is over and no part of the evidence; None: there is none.

    One that was made of the diagnosis' own sweeps would use the same data twice; one that was measured with a test mass
    is not of the bare robot. What was stored and does not fit the robot is passed over, and the log says so.
    """
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
        try:
            started_from(robot, store.estimate(one.campaign_id, one.revision).document, one.name, one.name)
        except BadInput as error:
            _log.info("estimate_passed_over", campaign=one.campaign_id, revision=one.revision, reason=str(error))
            continue
        return one
    return None
