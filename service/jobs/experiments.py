"""Experiments of a diagnosis: planned before they are proposed, to know that they can be run, and when wanted."""

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import cast

import structlog

from drivers.errors import DriveError
from service import BadInput, Conflict, SweepidError
from service.diagnosis import model_document
from service.diagnosis.verdict import Verdict
from service.identification.design.diagnosis_sweeps import DesignedSweep
from service.jobs.diagnosing import Diagnosing
from service.machine.execution.energising import Intention
from service.machine.execution.runner import Runner
from service.model.configuration import read_cell
from service.model.results.diagnosis import AxisDiagnosis, Experiment
from service.model.results.effect import RevisedAxis
from service.planning.campaigns.live import EventFeed
from service.planning.campaigns.stored_results import move_velocities
from service.planning.compiled_plan import Range
from service.planning.diagnosis import ExperimentPlace, build_experiment_plan
from service.planning.documents import MOVE_VELOCITY, ExperimentPlan, ExperimentRequest
from service.planning.machine_setup import MachineSetup, NeedsConfirmation, on_machine
from service.process.settings import Settings
from service.process.tasks import Background
from service.store.diagnoses import DiagnosisStore, ModelStore, check_free
from service.store.documents import (
    BoltedMass,
    CampaignDocument,
    CampaignState,
    DiagnosisDocument,
    DiagnosisEntry,
    DiagnosisState,
    EventDocument,
    EventKind,
    ModelDocument,
    NewDiagnosis,
    NewSweep,
    Weighing,
)
from service.store.store import Store


@dataclass(frozen=True)
class ExperimentPlanner:
    """Plans for the machine `setup`. Methods block."""

    settings: Settings
    store: Store
    setup: MachineSetup

    def plan(
        self,
        robot_id: int,
        experiment: Experiment,
        cell: str | None,
        typed: Mapping[str, str | None],
        by: str,
        test_mass: BoltedMass | None = None,
        campaigns: Sequence[int] = (),
    ) -> ExperimentPlan:
        """BadInput if none of its sweeps can be run.

        `cell`: None means that of the machine. `typed`, `by`: as in `MachineSetup.confirmed`. `test_mass`: its weight
        adds effort. `campaigns`: those that were diagnosed; it moves between poses as fast as the slowest of them, if
        each axis of this machine may.
        """
        designed = [DesignedSweep(sweep.spec, sweep.ramp, sweep.settle) for sweep in experiment.sweeps]
        origin, name = self.store.robot(robot_id), self.setup.own_cell(cell)
        made_for = self.setup.confirmed(origin, name, typed, by)
        robot = on_machine(origin.build(), self.setup.axes)
        asked = min(move_velocities(self.store, campaigns), default=MOVE_VELOCITY)
        velocity = min(asked, *(joint.velocity for joint in robot.chain.joints))
        request = ExperimentRequest(robot_id=robot_id, cell=name, test_mass=test_mass, move_velocity=velocity)
        plan = build_experiment_plan(robot, request, designed, read_cell(self.settings.cells_dir / f"{name}.yaml"))
        return plan.model_copy(update={"made_for": made_for})

    def place(self, robot_id: int) -> ExperimentPlace | None:
        """Where experiments of the robot would run; None if only a person can tell the machine's robot or cell."""
        cell = self.setup.cell
        if cell is None:
            return None
        try:
            self.setup.confirmed(self.store.robot(robot_id), cell, {}, "")
        except NeedsConfirmation:
            return None
        read = read_cell(self.settings.cells_dir / f"{cell}.yaml")
        return ExperimentPlace(ExperimentRequest(robot_id=robot_id, cell=cell), read, self.setup.axes)


_log = structlog.get_logger(__name__)


class Experiments:
    """Leads from a proposed experiment to the next diagnosis."""

    nobody = "unattended"  # name of the approver of unattended experiments

    def __init__(
        self,
        settings: Settings,
        store: Store,
        diagnoses: DiagnosisStore,
        runner: Runner,
        diagnosing: Diagnosing,
        planner: ExperimentPlanner,
    ) -> None:
        """`planner`: for the machine that runs the experiments."""
        self._planner = planner
        self._settings, self._store, self._diagnoses = settings, store, diagnoses
        self._runner, self._diagnosing = runner, diagnosing
        self._approving = asyncio.Lock()
        self._unattended: dict[int, Intention] = {}  # by diagnosis: of the request that permitted its experiments
        self._heard_events = Background()

    def plan(
        self,
        diagnosis_id: int,
        axis: str,
        cell: str | None,
        typed: Mapping[str, str | None],
        by: str,
        test_mass: BoltedMass | None = None,
    ) -> ExperimentPlan:
        """The plan of the next experiment of an axis (blocking), as `ExperimentPlanner`. Conflict if there is none."""
        diagnosis = self._diagnoses.diagnosis(diagnosis_id)
        experiment = proposed(diagnosis, axis)
        return self._planner.plan(diagnosis.robot_id, experiment, cell, typed, by, test_mass, diagnosis.campaigns)

    def permit(self, diagnosis_id: int, intention: Intention) -> None:
        """The experiments of an unattended diagnosis and of those that follow from it are wanted."""
        self._unattended[diagnosis_id] = intention

    async def approve(
        self,
        diagnosis_id: int,
        axis: str,
        approved_by: str,
        test_mass: BoltedMass | None,
        cell: str | None,
        intention: Intention,
        typed: Mapping[str, str | None] = MappingProxyType({}),
        seen: Mapping[str, Range] | None = None,
    ) -> CampaignDocument:
        """Plan the next experiment of an axis, and start its campaign. The diagnosis continues when that is completed.

        With the setting `approval` the campaign stays planned: its plan needs a separate approval, and then a start.
        `typed` as in `MachineSetup.confirmed`, `seen` as in `Runner.start`.

        `intention`: of the approval; it is that of the start.

        Conflict or DriveError if the machine is not free, `test_mass` is missing or not needed (BadInput), or the
        diagnosis is not finished or already has its experiment. Then nothing is stored and nothing moves.
        """
        async with self._approving:
            diagnosis = await asyncio.to_thread(self._diagnoses.diagnosis, diagnosis_id)
            check_free(diagnosis, await asyncio.to_thread(self._diagnoses.experiment_state, diagnosis_id))
            weighing = proposed(diagnosis, axis).weighs
            if weighing and test_mass is None:
                raise BadInput("test_mass", "the experiment requires a test mass: give the mass that is mounted")
            if test_mass is not None and not weighing:
                raise BadInput(
                    "test_mass",
                    "the experiment is without a test mass: remove the mass from the machine and from the request",
                )
            await self._runner.check_free(intention)
            plan = await asyncio.to_thread(self.plan, diagnosis_id, axis, cell, typed, approved_by, test_mass)
            campaign = await asyncio.to_thread(
                self._diagnoses.approve,
                diagnosis_id,
                axis,
                approved_by,
                test_mass,
                plan.model_dump(mode="json"),
                [NewSweep(spec=sweep.spec, mode=sweep.mode) for sweep in plan.sweeps],
            )
        if self._settings.approval:  # a user starts the campaign after the approval of the plan
            return campaign
        try:
            return await self._runner.start(campaign.id, intention, seen=seen)
        except (SweepidError, DriveError) as error:
            await self._runner.abort(campaign.id, f"could not be started: {error}")
            raise

    async def recover(self) -> None:
        """After a restart: start no motion, and diagnose the campaigns completed in the meantime."""
        await asyncio.to_thread(self._diagnoses.attend, "the service was restarted: no further motion without a person")
        for diagnosis in await asyncio.to_thread(self._diagnoses.to_go_on):
            await self._go_on(diagnosis)

    async def follow(self, feed: EventFeed, after: int) -> None:
        """Process the events after number `after`, until the feed is closed."""
        async for event in feed.follow(after):
            if event.kind in (EventKind.CAMPAIGN, EventKind.DIAGNOSIS):
                self._heard_events.begin(f"event {event.id}", self._heard(event))  # after an error: next start

    async def close(self) -> None:
        """Stop; the next process finds unfinished events again."""
        await self._heard_events.close()

    async def _heard(self, event: EventDocument) -> None:
        if event.kind is EventKind.CAMPAIGN and event.data["state"] == CampaignState.COMPLETED.value:
            for diagnosis in await asyncio.to_thread(self._diagnoses.to_go_on, event.campaign_id):
                await self._go_on(diagnosis)
        elif event.kind is EventKind.CAMPAIGN and event.data["state"] == CampaignState.ABORTED.value:
            await self._aborted(cast(int, event.campaign_id))
        elif event.kind is EventKind.DIAGNOSIS and event.data["state"] == DiagnosisState.DONE.value:
            diagnosis = await asyncio.to_thread(self._diagnoses.diagnosis, cast(int, event.data["diagnosis"]))
            if diagnosis.unattended and diagnosis.experiment is None:
                await self._alone(diagnosis)

    async def _aborted(self, campaign_id: int) -> None:
        """An unattended experiment was aborted: from now on a user decides."""
        diagnosis = await asyncio.to_thread(self._diagnoses.of_experiment, campaign_id)
        if diagnosis is not None and diagnosis.unattended:
            cause = f"campaign {campaign_id} was aborted"
            self._unattended.pop(diagnosis.id, None)
            await asyncio.to_thread(self._diagnoses.attend, cause, diagnosis.id)

    async def _go_on(self, parent: DiagnosisEntry) -> None:
        """Diagnose with the sweeps of the experiment; the results of the other axes stay."""
        experiment = parent.experiment
        if experiment is None:
            return
        weighed, campaigns = parent.weighed, parent.campaigns
        if experiment.test_mass is None:
            campaigns = (*campaigns, experiment.campaign_id)
        else:
            weighed = Weighing(campaign_id=experiment.campaign_id, mass=experiment.test_mass)
        new = NewDiagnosis(
            robot_id=parent.robot_id,
            campaigns=campaigns,
            axes=parent.axes,
            model=parent.model,
            estimate=parent.estimate,
            weighed=weighed,
            parent=parent.id,
            unattended=parent.unattended,
        )
        others = [joint for joint in parent.axes if joint != experiment.axis]
        diagnosis = await asyncio.to_thread(self._diagnoses.go_on, new, others)
        if diagnosis is not None:
            if (intention := self._unattended.pop(parent.id, None)) is not None:
                self._unattended[diagnosis.id] = intention
            _log.info("diagnosis_goes_on", diagnosis=diagnosis.id, parent=parent.id)
            self._diagnosing.submit(diagnosis)

    async def _alone(self, diagnosis: DiagnosisDocument) -> None:
        """Start the next unattended experiment, or store the end of the loop and its reason."""
        axis, cause = await asyncio.to_thread(self._next_axis, diagnosis)
        intention = self._unattended.get(diagnosis.id)
        if axis is not None and intention is None:
            cause = f"{axis}: the request of the diagnosis is not of this run of the service"
        elif axis is not None and intention is not None:
            try:
                await self.approve(diagnosis.id, axis, Experiments.nobody, None, None, intention)
                return
            except (SweepidError, DriveError) as error:
                cause = f"{axis}: {error}"
        self._unattended.pop(diagnosis.id, None)
        await asyncio.to_thread(self._diagnoses.attend, cause, diagnosis.id)

    def _next_axis(self, diagnosis: DiagnosisDocument) -> tuple[str | None, str]:
        """The first undecided axis that may have an experiment; the reason if there is none; "" if nothing is open."""
        causes: list[str] = []
        for axis in diagnosis.axes:
            try:
                experiment = proposed(diagnosis, axis)
            except Conflict:
                continue
            if diagnosis.verdicts[axis] not in (
                Verdict.AMBIGUOUS.value,
                Verdict.UNKNOWN.value,
                Verdict.UNTESTABLE.value,
            ):
                continue  # more tests are possible, but there is no gap left
            if not experiment.weighs:
                return axis, ""
            causes.append(f"{axis}: a test mass needs a person")
        return None, "; ".join(causes)


def proposed(diagnosis: DiagnosisDocument, axis: str) -> Experiment:
    """`next_experiment` of an axis; Conflict if the diagnosis is not finished or proposes none, BadInput if unknown."""
    if axis not in diagnosis.axes:
        raise BadInput(
            "axis", f"{axis} is not an axis of diagnosis {diagnosis.id}; its axes are {', '.join(diagnosis.axes)}"
        )
    found = diagnosis.found("plan").axes
    experiment = found[axis].next_experiment if axis in found else None
    if experiment is None:
        raise Conflict(f"diagnosis {diagnosis.id} proposes no experiment for {axis}")
    return experiment


def accept_model(
    store: Store,
    diagnoses: DiagnosisStore,
    models: ModelStore,
    diagnosis_id: int,
    axes: Sequence[str] | None,
    accepted_by: str,
) -> ModelDocument:
    """The next revision of the robot's model, with the effects of `axes` (None: all axes with something to accept). The
    other axes are copied from the newest revision.

    Conflict if nothing is named and no known effect has changed, all effects were rolled back, the diagnosis already
    became a model, or the newest revision contains more about these axes than the diagnosis did. BadInput for a
    joint that is not in the diagnosis.
    """
    diagnosis = diagnoses.diagnosis(diagnosis_id)
    joints = _acceptable(diagnosis, axes)
    newest = models.newest(diagnosis.robot_id)
    if newest is not None and newest.diagnosis_id != diagnosis_id:
        began = None if diagnosis.model is None else models.model(diagnosis.model)
        for joint in joints:
            if _axes(newest).get(joint) != _axes(began).get(joint):
                raise Conflict(
                    f"{joint}: model {newest.id} was accepted in the meantime, and diagnosis "
                    f"{diagnosis_id} does not start from it; diagnose again from model {newest.id}"
                )
    robot = store.robot(diagnosis.robot_id).build()
    revision = model_document(robot, diagnosis.found("accept"), joints, None if newest is None else newest.content)
    return models.add(diagnosis_id, accepted_by, revision.as_json(), None if newest is None else newest.id)


def _axes(model: ModelDocument | None) -> Mapping[str, RevisedAxis]:
    return {} if model is None else model.content.axes


def _acceptable(diagnosis: DiagnosisDocument, axes: Sequence[str] | None) -> tuple[str, ...]:
    """The joints whose effects are accepted."""
    found = diagnosis.found("accept").axes
    refusals = {
        joint: _refusal(found[joint]) if joint in found else f"has no result, {diagnosis.cause}"
        for joint in diagnosis.axes
    }
    if axes is None:
        named = tuple(joint for joint, refusal in refusals.items() if not refusal)
        if not named:
            raise Conflict("; ".join(f"{joint}: {refusal}" for joint, refusal in refusals.items()))
        return named
    for joint in axes:
        if joint not in refusals:
            raise BadInput(
                "axes", f"{joint} is not an axis of diagnosis {diagnosis.id}; its axes are {', '.join(diagnosis.axes)}"
            )
        if refusals[joint]:
            raise Conflict(f"{joint}: {refusals[joint]}")
    return tuple(joint for joint in diagnosis.axes if joint in axes)


def _refusal(axis: AxisDiagnosis) -> str:
    """The reason why an axis has nothing to accept, or ""."""
    rolled_back = axis.rolled_back
    if not [effect for effect in axis.effects if effect.effect not in rolled_back] and rolled_back:
        return f"{', '.join(rolled_back)} did not improve held-out sweeps and was rolled back"
    if axis.verdict != "named" and not (axis.verdict in ("none", "untestable") and axis.changes):
        return f"the verdict is {axis.verdict}, not named"
    return ""
