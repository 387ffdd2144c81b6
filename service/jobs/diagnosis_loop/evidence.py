"""The evidence of a diagnosis: the complete sweeps of several campaigns of one robot, with a common time axis."""

from collections.abc import Sequence

from service.diagnosis import is_evidence
from service.jobs.worker import RecordedSweep
from service.model.errors import BadInput, Conflict, NotFound
from service.model.recording import SweepSpec
from service.store.documents import CampaignDocument, RecordingDocument
from service.store.files.recordings import RecordingFiles
from service.store.store import COMPLETE, OVER, Store


def campaigns_of(store: Store, campaigns: Sequence[int]) -> tuple[CampaignDocument, ...]:
    """The campaigns in the order of measurement, without duplicates.

    BadInput (field `campaigns`) if one does not exist; Conflict if one is not finished, or is of another robot.
    """
    try:
        found = [store.campaign(number) for number in sorted(set(campaigns))]
    except NotFound as error:
        raise BadInput("campaigns", str(error)) from None
    for campaign in found:
        if campaign.state not in OVER:
            raise Conflict(f"campaign {campaign.id} is {campaign.state.value}: its sweeps are not complete yet")
        if campaign.robot_id != found[0].robot_id:
            raise Conflict(
                f"campaign {campaign.id} is of robot {campaign.robot_id}, campaign {found[0].id} of "
                f"robot {found[0].robot_id}; select campaigns of one robot"
            )
    return tuple(sorted(found, key=lambda campaign: (campaign.started_at or campaign.created_at, campaign.id)))


def swept_axes(store: Store, campaigns: Sequence[CampaignDocument]) -> tuple[str, ...]:
    """The joints with complete sweeps that contain motion, in the order of the robot."""
    swept = {spec.axis for campaign in campaigns for _, spec in _complete(store, campaign)}
    return tuple(joint for joint in store.robot(campaigns[0].robot_id).build().joints if joint in swept)


def recorded_sweeps(
    store: Store, files: RecordingFiles, campaigns: Sequence[CampaignDocument], joint: str
) -> tuple[tuple[RecordedSweep, ...], tuple[str, ...]]:
    """The complete sweeps of an axis, and the SHA-256 of their files; BadInput if a file was changed.

    Interrupted and failed sweeps, and those that are no evidence, are left out. The name of a sweep is
    "campaign/sweep". `started_at` counts from the first campaign's start. If a later campaign repeats pose and block,
    the two are not repeats back to back: the block name then contains the campaign.
    """
    sweeps: list[RecordedSweep] = []
    hashes: list[str] = []
    visits: set[tuple[str, tuple[float, ...]]] = set()
    start = campaigns[0].started_at or campaigns[0].created_at
    end = 0.0
    for campaign in campaigns:
        own = [(recording, spec) for recording, spec in _complete(store, campaign) if spec.axis == joint]
        # an imported campaign starts at its import; it must not overlap the previous one
        shift = max(((campaign.started_at or campaign.created_at) - start).total_seconds(), end)
        for recording, spec in own:
            file = files.named(recording)
            hashes.append(recording.sha256)
            moved = spec.model_copy(
                update={
                    "id": f"{campaign.id}/{spec.id}",
                    "started_at": spec.started_at + shift,
                    "block": _again(spec, campaign.id) if (spec.block, spec.pose) in visits else spec.block,
                }
            )
            sweeps.append(RecordedSweep(moved, file))
            end = max(end, moved.started_at + recording.samples / spec.sample_rate)
        visits.update((spec.block, spec.pose) for _, spec in own)
    return tuple(sweeps), tuple(hashes)


def _again(spec: SweepSpec, campaign_id: int) -> str:
    return f"{spec.block} of campaign {campaign_id}".strip()


def _complete(store: Store, campaign: CampaignDocument) -> list[tuple[RecordingDocument, SweepSpec]]:
    return [
        (store.recording(campaign.id, sweep.number), sweep.spec)
        for sweep in store.sweeps(campaign.id)
        if sweep.state in COMPLETE and is_evidence(sweep.spec)
    ]
