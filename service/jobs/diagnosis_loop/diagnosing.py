"""Open diagnoses: one job per axis. Results are stored as they arrive; the document when all are there.

The store is the outbox, as in `service.jobs.jobs`: waiting and running diagnoses are found after a restart, and an
axis that has a result is not computed again.
"""

import asyncio
import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial

import structlog

from service.diagnosis import compose
from service.diagnosis.fit.fitted import Parameter
from service.identification.estimates.torque_gain import KnownMass
from service.jobs.diagnosis_loop.evidence import campaigns_of, recorded_sweeps, swept_axes
from service.jobs.diagnosis_loop.starting import Start, latest_estimate
from service.jobs.open_jobs import OpenJobs
from service.jobs.worker import DiagnosisJob, JobFailed, Worker
from service.model.errors import BadInput, Conflict, NotFound
from service.model.results.diagnosis import Diagnosis
from service.model.results.effect import Value
from service.store.diagnosis.diagnoses import DiagnosisStore
from service.store.diagnosis.model_revisions import ModelStore
from service.store.diagnosis_documents import DiagnosisDocument, DiagnosisEntry, NewDiagnosis, Weighing
from service.store.files.recordings import RecordingFiles
from service.store.store import Store

_log = structlog.get_logger(__name__)


class Diagnosing(OpenJobs):
    """Submits axes to the worker and stores their results."""

    def __init__(
        self, store: Store, diagnoses: DiagnosisStore, models: ModelStore, files: RecordingFiles, worker: Worker
    ) -> None:
        super().__init__()
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
            done = await asyncio.gather(*(self._axis(diagnosis.id, job) for job in jobs), return_exceptions=True)
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

    async def _axis(self, diagnosis_id: int, job: DiagnosisJob) -> None:
        try:
            document = await self._worker.run_patiently(job)
        except JobFailed as error:
            raise JobFailed(f"{job.joint}: {error}") from None
        verdict = str(document["verdict"])
        await asyncio.to_thread(self._diagnoses.add_result, diagnosis_id, job.joint, verdict, document)

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
        # the same files may be used with different options: the key contains all of them
        content = [
            diagnosis.model_dump(mode="json", include={"robot_id", "campaigns"}),
            None if weighing is None else weighing.model_dump(mode="json"),
            None if diagnosis.estimate is None else diagnosis.estimate.model_dump(mode="json"),
            [robot.description.model_dump(mode="json"), robot.urdf_text],
            {effect: {name: asdict(value) for name, value in own.items()} for effect, own in known.items()},
            [hashes, mass_hashes],
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
        )

    def _known(self, model_id: int | None, joint: str) -> dict[str, dict[str, Parameter]]:
        """Known effects of the axis in the model, with their parameters."""
        if model_id is None:
            return {}
        axes = self._models.model(model_id).content.axes
        return {
            effect.effect: {name: _parameter(value) for name, value in effect.parameters.items()}
            for effect in (axes[joint].effects if joint in axes else ())
        }

    def _weighing(self, diagnosis: DiagnosisEntry, joint: str) -> Weighing | None:
        """The newest campaign with a known mass that moved the axis, of this diagnosis or of one that it continues."""
        at: DiagnosisEntry | None = diagnosis
        while at is not None:
            if at.weighed is not None:
                swept = swept_axes(self._store, campaigns_of(self._store, [at.weighed.campaign_id]))
                if joint in swept:
                    return at.weighed
            at = None if at.parent is None else self._diagnoses.diagnosis(at.parent)
        return None

    def _composed(self, diagnosis: DiagnosisEntry) -> Diagnosis | None:
        """The document of the axes that have a result."""
        results = self._diagnoses.results(diagnosis.id)
        robot = self._store.robot(diagnosis.robot_id).build()
        done = {joint: results[joint] for joint in diagnosis.axes if joint in results}
        return Diagnosis.read(compose(robot, done), f"diagnosis {diagnosis.id}") if done else None


def _parameter(value: Value) -> Parameter:
    """A parameter; null in JSON means infinite."""
    return Parameter(value.value, math.inf if value.std is None else value.std, value.unit)
