"""Open diagnoses: their evidence, the estimate from which they start, and one job per axis.

Results are stored as they arrive; the document when all are there. The store is the outbox, as in `service.jobs.jobs`:
waiting and running diagnoses are found after a restart, and an axis that has a result is not computed again.
"""

import asyncio
import hashlib
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from enum import Enum
from functools import partial

import structlog

from service import BadInput, Conflict, NotFound
from service.diagnosis import compose, is_evidence
from service.diagnosis.fit.fitted import Parameter
from service.formats.export.started_robot import started_from
from service.identification.estimates.torque_gain import KnownMass
from service.jobs.jobs import OpenJobs
from service.jobs.work import DiagnosisJob, JobFailed, RecordedSweep, Worker
from service.model import SweepSpec
from service.model.results.diagnosis import AxisDiagnosis, Diagnosis
from service.model.results.estimate import Estimate
from service.planning.campaigns.stored_results import campaign_beside
from service.planning.diagnosis import ExperimentPlace
from service.store.diagnoses import DiagnosisStore, ModelStore
from service.store.documents import (
    CampaignDocument,
    CampaignState,
    DiagnosisDocument,
    DiagnosisEntry,
    EstimateOf,
    NewDiagnosis,
    RecordingDocument,
    Weighing,
)
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
    swept = {spec.axis for campaign in campaigns for spec, _ in _complete(store, campaign)}
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
        own = [(spec, recording) for spec, recording in _complete(store, campaign) if spec.axis == joint]
        # an imported campaign starts at its import; it must not overlap the previous one
        shift = max(((campaign.started_at or campaign.created_at) - start).total_seconds(), end)
        for spec, recording in own:
            file = files.named(recording)
            hashes.append(recording.sha256)
            moved = spec.model_copy(
                update={
                    "id": f"{campaign.id}/{spec.id}",
                    "started_at": spec.started_at + shift,
                    "block": f"{spec.block} of campaign {campaign.id}".strip()
                    if (spec.block, spec.pose) in visits
                    else spec.block,
                }
            )
            sweeps.append(RecordedSweep(moved, file))
            end = max(end, moved.started_at + recording.samples / spec.sample_rate)
        visits.update((spec.block, spec.pose) for spec, _ in own)
    return tuple(sweeps), tuple(hashes)


def _complete(store: Store, campaign: CampaignDocument) -> list[tuple[SweepSpec, RecordingDocument]]:
    return [each for each in store.recorded_sweeps(campaign.id, COMPLETE) if is_evidence(each[0])]


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
        if campaign.state not in (CampaignState.COMPLETED, CampaignState.ABORTED):  # a further revision may follow
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


class Diagnosing(OpenJobs):
    """Submits axes to the worker and stores their results."""

    def __init__(
        self,
        store: Store,
        diagnoses: DiagnosisStore,
        models: ModelStore,
        files: RecordingFiles,
        worker: Worker,
        place: Callable[[int], ExperimentPlace | None],
    ) -> None:
        """`place`: where the experiments of a robot would run, if that is known; blocks."""
        super().__init__()
        self._place = place
        self._store, self._diagnoses, self._models = store, diagnoses, models
        self._files, self._worker = files, worker

    async def request(
        self,
        campaigns: Sequence[int],
        axes: Sequence[str] | None,
        model: int | None,
        unattended: bool,
        start: Start = Start.ESTIMATE,
    ) -> DiagnosisDocument:
        """A diagnosis of the axes (None: all) that moved in the campaigns, with a model as the start; returns at once.

        BadInput names the field. Conflict if campaigns and model do not belong together, or a campaign is not finished.
        """
        new = await asyncio.to_thread(self._checked, campaigns, axes, model, unattended)
        if start is Start.ESTIMATE:
            estimate = await asyncio.to_thread(latest_estimate, self._store, self._diagnoses, new)
            new = new.model_copy(update={"estimate": estimate})
        diagnosis = await asyncio.to_thread(self._diagnoses.add, new)
        self.submit(diagnosis)
        return diagnosis

    async def recover(self) -> None:
        """Submit the diagnoses that the previous process left open."""
        for diagnosis in await asyncio.to_thread(self._diagnoses.open):
            self.submit(diagnosis)

    def submit(self, diagnosis: DiagnosisEntry) -> None:
        """Start the jobs of a diagnosis; returns at once."""
        self.begin(f"diagnosis {diagnosis.id}", partial(self._do, diagnosis), diagnosis=diagnosis.id)

    def _checked(
        self, campaigns: Sequence[int], axes: Sequence[str] | None, model: int | None, unattended: bool
    ) -> NewDiagnosis:
        found = campaigns_of(self._store, campaigns)
        for number, mass in self._diagnoses.masses([campaign.id for campaign in found]).items():
            raise Conflict(
                f"campaign {number} was measured with a test mass of {mass.mass:g} kg: it can only be "
                "used by the diagnosis that requested it, not for the robot without the mass"
            )
        robot_id = found[0].robot_id
        swept = swept_axes(self._store, found)
        if not swept:
            raise Conflict(f"campaigns {', '.join(str(one.id) for one in found)} have no complete sweep that moves")
        for joint in axes or ():
            if joint not in swept:
                raise BadInput(
                    "axes", f"{joint} has no complete sweep that moves; axes with complete sweeps: {', '.join(swept)}"
                )
        if model is not None:
            self._check_model(model, robot_id)
        return NewDiagnosis(
            robot_id=robot_id,
            campaigns=tuple(campaign.id for campaign in found),
            axes=tuple(joint for joint in swept if axes is None or joint in axes),
            model=model,
            unattended=unattended,
        )

    def _check_model(self, model_id: int, robot_id: int) -> None:
        try:
            model = self._models.model(model_id)
        except NotFound as error:
            raise BadInput("model", str(error)) from None
        if model.robot_id != robot_id:
            raise Conflict(f"model {model_id} is of robot {model.robot_id}; the campaigns are of robot {robot_id}")

    async def _do(self, diagnosis: DiagnosisEntry) -> None:
        try:
            results = await asyncio.to_thread(self._diagnoses.results, diagnosis.id)
            jobs = [await asyncio.to_thread(self._job, diagnosis, one) for one in diagnosis.axes if one not in results]
            await asyncio.to_thread(self._diagnoses.begin, diagnosis.id)
            done = await asyncio.gather(*(self._axis(diagnosis, job) for job in jobs), return_exceptions=True)
            failed = [error for error in done if isinstance(error, JobFailed)]
            for error in done:
                if error is not None and error not in failed:
                    raise error
            document = await asyncio.to_thread(self._composed, diagnosis)
            if failed or document is None:
                await self._fail(diagnosis, "; ".join(str(error) for error in failed), document)
                return
            await asyncio.to_thread(self._diagnoses.finish, diagnosis.id, document.as_json())
            _log.info("diagnosis", diagnosis=diagnosis.id)
        except (BadInput, Conflict) as error:
            await self._fail(diagnosis, str(error), None)

    async def _fail(self, diagnosis: DiagnosisEntry, cause: str, document: Diagnosis | None) -> None:
        """Store the failure; the results of the other axes are kept."""
        _log.error("diagnosis_failed", diagnosis=diagnosis.id, cause=cause)
        kept = None if document is None else document.as_json()
        await asyncio.to_thread(self._diagnoses.fail, diagnosis.id, cause, kept)

    async def _axis(self, diagnosis: DiagnosisEntry, job: DiagnosisJob) -> None:
        try:
            document = await self._worker.run_patiently(job)
        except JobFailed as error:
            raise JobFailed(f"{job.joint}: {error}") from None
        add = self._diagnoses.add_result
        await asyncio.to_thread(add, diagnosis.id, job.joint, document.verdict, document.as_json())

    def _job(self, diagnosis: DiagnosisEntry, joint: str) -> DiagnosisJob:
        robot = self._store.robot(diagnosis.robot_id)
        sweeps, hashes = recorded_sweeps(
            self._store, self._files, campaigns_of(self._store, diagnosis.campaigns), joint
        )
        mass, weighed, mass_hashes = None, (), ()
        weighing = self._weighing(diagnosis, joint)
        if weighing is not None:
            campaign = campaigns_of(self._store, [weighing.campaign_id])
            weighed, mass_hashes = recorded_sweeps(self._store, self._files, campaign, joint)
            mass = KnownMass(**weighing.mass.model_dump())
        known, start = self._known(diagnosis.model, joint), diagnosis.estimate
        experiments, place = self._experiments(diagnosis, joint), self._place(diagnosis.robot_id)
        # the same files may be used with different options: the key contains all of them
        content = [
            diagnosis.model_dump(mode="json", include={"robot_id", "campaigns"}),
            None if weighing is None else weighing.model_dump(mode="json"),
            None if diagnosis.estimate is None else diagnosis.estimate.model_dump(mode="json"),
            [robot.description.model_dump(mode="json"), robot.urdf_text],
            {effect: {name: asdict(value) for name, value in own.items()} for effect, own in known.items()},
            [hashes, mass_hashes],
            [experiments, repr(place)],
        ]
        digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
        return DiagnosisJob(
            key=f"diagnose-{digest}-{joint}",
            robot=robot.description,
            urdf_text=robot.urdf_text,
            joint=joint,
            sweeps=sweeps,
            known=known,
            mass=mass,
            weighed=weighed,
            estimate=None if start is None else self._store.estimate(start.campaign_id, start.revision).document,
            started_from="" if start is None else start.name,
            experiments=experiments,
            place=place,
        )

    def _before(self, diagnosis: DiagnosisEntry) -> Iterator[DiagnosisEntry]:
        """The diagnoses that it continues, the newest first."""
        while diagnosis.parent is not None:
            diagnosis = self._diagnoses.diagnosis(diagnosis.parent)
            yield diagnosis

    def _experiments(self, diagnosis: DiagnosisEntry, joint: str) -> int:
        """Number of experiments of the axis that led to this diagnosis."""
        run = [before.experiment for before in self._before(diagnosis)]
        return sum(one is not None and one.axis == joint for one in run)

    def _known(self, model_id: int | None, joint: str) -> dict[str, dict[str, Parameter]]:
        """Known effects of the axis in the model, with their parameters."""
        if model_id is None:
            return {}
        axes = self._models.model(model_id).content.axes
        return {
            effect.effect: {  # null in JSON means infinite
                name: Parameter(value.value, math.inf if value.std is None else value.std, value.unit)
                for name, value in effect.parameters.items()
            }
            for effect in (axes[joint].effects if joint in axes else ())
        }

    def _weighing(self, diagnosis: DiagnosisEntry, joint: str) -> Weighing | None:
        """The newest campaign with a known mass that moved the axis, of this diagnosis or of one that it continues."""
        for at in (diagnosis, *self._before(diagnosis)):
            if at.weighed is not None:
                swept = swept_axes(self._store, campaigns_of(self._store, [at.weighed.campaign_id]))
                if joint in swept:
                    return at.weighed
        return None

    def _composed(self, diagnosis: DiagnosisEntry) -> Diagnosis | None:
        """The document of the axes that have a result."""
        results = self._diagnoses.results(diagnosis.id)
        robot = self._store.robot(diagnosis.robot_id).build()
        place = f"diagnosis {diagnosis.id}"
        done = {joint: AxisDiagnosis.read(results[joint], place) for joint in diagnosis.axes if joint in results}
        return compose(robot, done) if done else None
