"""What a diagnosis looks at: the complete sweeps of several campaigns of one robot, on one clock."""

from collections.abc import Sequence

from service.diagnosis import is_evidence
from service.errors import BadInput, Conflict, NotFound
from service.recording import SweepSpec
from service.store.documents import CampaignDocument, CampaignState, RecordingDocument, SweepState
from service.store.files.recordings import RecordingFiles
from service.store.store import Store
from service.worker import RecordedSweep

_OVER = (CampaignState.MEASURED, CampaignState.COMPLETED, CampaignState.ABORTED)
_COMPLETE = (SweepState.RECORDED, SweepState.IDENTIFIED)


def campaigns_of(store: Store, campaigns: Sequence[int]) -> tuple[CampaignDocument, ...]:
    """The campaigns in the order in which they were measured, each once.

    BadInput (field `campaigns`) for one that does not exist; Conflict where one is not over, or of another robot.
    """
    try:
        found = [store.campaign(number) for number in sorted(set(campaigns))]
    except NotFound as error:
        raise BadInput("campaigns", str(error)) from None
    for campaign in found:
        if campaign.state not in _OVER:
            raise Conflict(f"campaign {campaign.id} is {campaign.state.value}: its sweeps are not all there yet")
        if campaign.robot_id != found[0].robot_id:
            raise Conflict(
                f"campaign {campaign.id} measured robot {campaign.robot_id}, campaign {found[0].id} robot "
                f"{found[0].robot_id}; a diagnosis is about one robot"
            )
    return tuple(sorted(found, key=lambda campaign: (campaign.started_at or campaign.created_at, campaign.id)))


def swept_axes(store: Store, campaigns: Sequence[CampaignDocument]) -> tuple[str, ...]:
    """The joints that have complete sweeps that move, in the robot's order."""
    swept = {spec.axis for campaign in campaigns for _, spec in _complete(store, campaign)}
    return tuple(joint for joint in store.robot(campaigns[0].robot_id).build().joints if joint in swept)


def recorded_sweeps(
    store: Store, files: RecordingFiles, campaigns: Sequence[CampaignDocument], joint: str
) -> tuple[tuple[RecordedSweep, ...], tuple[str, ...]]:
    """The complete sweeps of an axis, and the SHA-256 of their files; BadInput if one is not as it was written.

    What was interrupted or failed, or is no evidence, is left out. A sweep is named
    "campaign/sweep". `started_at` counts from the first campaign's begin. What a later campaign measured again, same
    pose and block, is no repeat back to back: its block then names the campaign.
    """
    sweeps: list[RecordedSweep] = []
    told: list[str] = []
    visits: set[tuple[str, tuple[float, ...]]] = set()
    start = campaigns[0].started_at or campaigns[0].created_at
    end = 0.0
    for campaign in campaigns:
        own = [(recording, spec) for recording, spec in _complete(store, campaign) if spec.axis == joint]
        # an imported campaign began, for us, when it came: it must not overlap the one before
        shift = max(((campaign.started_at or campaign.created_at) - start).total_seconds(), end)
        for recording, spec in own:
            files.check(recording)
            told.append(recording.sha256)
            moved = spec.model_copy(
                update={
                    "id": f"{campaign.id}/{spec.id}",
                    "started_at": spec.started_at + shift,
                    "block": _again(spec, campaign.id) if (spec.block, spec.pose) in visits else spec.block,
                }
            )
            sweeps.append(RecordedSweep(moved, files.path(recording).absolute()))
            end = max(end, moved.started_at + recording.samples / spec.sample_rate)
        visits.update((spec.block, spec.pose) for _, spec in own)
    return tuple(sweeps), tuple(told)


def _again(spec: SweepSpec, campaign_id: int) -> str:
    return f"{spec.block} of campaign {campaign_id}".strip()


def _complete(store: Store, campaign: CampaignDocument) -> list[tuple[RecordingDocument, SweepSpec]]:
    return [
        (store.recording(campaign.id, sweep.number), sweep.spec)
        for sweep in store.sweeps(campaign.id)
        if sweep.state in _COMPLETE and is_evidence(sweep.spec)
    ]
