"""The loop of a diagnosis: what goes on after a restart, and where it ends when nobody attends."""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace

import pytest

from service import BadInput, Conflict
from service.identification.design.diagnosis_sweeps import DesignedSweep
from service.jobs.dask_workers import DaskWorkers
from service.jobs.diagnosing import Diagnosing
from service.jobs.experiments import ExperimentPlanner, Experiments
from service.model import Robot
from service.planning.campaigns.live import EventFeed
from service.planning.documents import PEAK_VELOCITY
from service.planning.machine_setup import DriveAxis, MachineSetup
from service.process.settings import Cluster, Settings
from service.store.diagnoses import DiagnosisStore, ModelStore
from service.store.documents import BoltedMass, CampaignState, DiagnosisDocument, NewDiagnosis, NewSweep
from tests.stored.documents import axis_document, diagnosis_document, stored
from tests.unit.service.campaigns.conftest import Again, Bench, spec, until

MASS = BoltedMass(mass=20.0, center=(0.1, 0.0, 0.0))


@dataclass
class Loop:
    bench: Bench
    diagnoses: DiagnosisStore
    diagnosing: Diagnosing
    experiments: Experiments
    new: NewDiagnosis

    def of(self, *axes: DriveAxis) -> Experiments:
        """Experiments of a machine with these axes."""
        bench = self.bench
        setup = MachineSetup("machine", axes, robot=bench.store.robot(self.new.robot_id), cell="workshop")
        planner = ExperimentPlanner(Settings(), bench.store, setup)
        return Experiments(Settings(), bench.store, self.diagnoses, bench.runner, self.diagnosing, planner)

    def done(
        self, kind: str | None, new: NewDiagnosis | None = None, verdict: str = "ambiguous", *, sweeps: bool = False
    ) -> DiagnosisDocument:
        """A diagnosis of joint_1 that proposes an experiment of a kind, with or without its sweeps."""
        diagnosis = self.diagnoses.add(new or self.new)
        self.experiments.permit(diagnosis.id, self.bench.intention)
        proposal = stored("diagnosis-open")["axes"]["joint_1"]["next_experiment"]
        wanted = None if kind is None else proposal | {"kind": kind} | ({} if sweeps else {"sweeps": []})
        self.diagnoses.add_result(diagnosis.id, "joint_1", verdict, {"verdict": verdict})
        axis = axis_document(verdict=verdict, next_experiment=wanted)
        self.diagnoses.finish(diagnosis.id, diagnosis_document(joint_1=axis))
        return self.diagnoses.diagnosis(diagnosis.id)

    def measured(self, diagnosis: DiagnosisDocument, mass: BoltedMass | None) -> int:
        """Its experiment, completed; the campaign."""
        sweeps = [NewSweep(spec=spec(1, (0.0, 0.0, 0.0)), mode=None)]
        campaign = self.diagnoses.approve(diagnosis.id, "joint_1", "Ada", mass, {}, sweeps)
        for state in (CampaignState.RUNNING, CampaignState.MEASURED, CampaignState.COMPLETED):
            self.bench.store.move_campaign(campaign.id, lambda _, state=state: state)
        return campaign.id

    def children(self) -> list[NewDiagnosis]:
        return [one for one in self.diagnoses.diagnoses() if one.parent is not None]


@pytest.fixture
async def loop(again: Again, robot: Robot) -> AsyncIterator[Loop]:
    async with again() as bench:
        diagnoses = DiagnosisStore(bench.database)
        nobody = DaskWorkers(Cluster("tcp://127.0.0.1:1"))
        setup = MachineSetup("machine", robot=bench.store.robot(bench.campaign.robot_id), cell="workshop")
        planner, models = ExperimentPlanner(Settings(), bench.store, setup), ModelStore(bench.database)
        diagnosing = Diagnosing(bench.store, diagnoses, models, bench.files, nobody, planner.place)
        experiments = Experiments(Settings(), bench.store, diagnoses, bench.runner, diagnosing, planner)
        new = NewDiagnosis(
            robot_id=bench.campaign.robot_id, campaigns=(bench.campaign.id,), axes=("joint_1",), unattended=True
        )
        yield Loop(bench, diagnoses, diagnosing, experiments, new)
        await experiments.close()
        await diagnosing.close()


def test_an_experiment_keeps_the_lower_limits_of_the_drive(loop: Loop, robot: Robot) -> None:
    proposed = loop.done("reversal", sweeps=True)
    effort = robot.chain.joints[0].effort
    lower = DriveAxis(joint="joint_1", velocity_limit=0.14, effort_limit=0.75 * effort)
    for axes, limits in (((), (PEAK_VELOCITY, effort)), ((lower,), (0.14, 0.75 * effort))):
        plan = loop.of(*axes).plan(proposed.id, "joint_1", None, {}, "Ada")
        assert {(sweep.velocity_limit, sweep.effort_limit) for sweep in plan.sweeps} == {limits}


def test_an_experiment_travels_as_fast_as_the_slowest_diagnosed_campaign(loop: Loop) -> None:
    store, new = loop.bench.store, loop.new
    for velocities, expected in (((), 0.1), ((0.3,), 0.3), ((0.4, 0.2), 0.2)):
        plans = [store.add_plan(new.robot_id, {"request": {"move_velocity": velocity}}) for velocity in velocities]
        campaigns = tuple(store.add_campaign(plan.id, []).id for plan in plans) or new.campaigns
        proposed = loop.done("reversal", new.model_copy(update={"campaigns": campaigns}), sweeps=True)
        plan = loop.experiments.plan(proposed.id, "joint_1", None, {}, "Ada")
        assert plan.request.move_velocity == expected
    slow = DriveAxis(joint="joint_2", velocity_limit=0.15)
    assert loop.of(slow).plan(proposed.id, "joint_1", None, {}, "Ada").request.move_velocity == 0.15


def test_an_experiment_that_the_machine_cannot_run_is_refused_when_it_is_planned(loop: Loop) -> None:
    """As of an axis whose drive permits less than every sweep needs."""
    wanted = loop.done("reversal", sweeps=True).found().axes["joint_1"].next_experiment
    assert wanted is not None
    designed = [DesignedSweep(sweep.spec, sweep.ramp, sweep.settle) for sweep in wanted.sweeps]
    bench, weak = loop.bench, DriveAxis(joint="joint_1", effort_limit=0.01)
    robot = bench.store.robot(loop.new.robot_id)
    own = MachineSetup("machine", robot=robot, cell="workshop")
    for setup, kept, reason in (
        (own, tuple(designed), ""),
        (replace(own, axes=(weak,)), (), "none of its sweeps can be run; reason for the first: "),
    ):
        place = ExperimentPlanner(Settings(), bench.store, setup).place(robot.id)
        assert place is not None
        runnable, told = place.runnable(robot.build(), designed)
        assert runnable == kept
        assert told.startswith(reason) if reason else told == "", told
    for setup in (replace(own, cell=None), replace(own, robot=None)):  # a person tells the cell, or that robot
        assert ExperimentPlanner(Settings(), bench.store, setup).place(robot.id) is None


@pytest.mark.parametrize("mass", [None, MASS])
async def test_an_experiment_completed_before_a_restart_leads_to_its_diagnosis(
    loop: Loop, mass: BoltedMass | None
) -> None:
    parent = loop.done("reversal")
    campaign = loop.measured(parent, mass)
    await loop.experiments.recover()
    await loop.experiments.recover()
    (child,) = loop.children()
    assert (child.parent, child.unattended) == (parent.id, False)
    if mass is None:
        assert (child.campaigns, child.weighed) == ((*parent.campaigns, campaign), None)
    else:
        assert (child.campaigns, child.weighed and child.weighed.mass) == (parent.campaigns, mass)


@asynccontextmanager
async def followed(loop: Loop, after: int | None = None) -> AsyncGenerator[None]:
    """The events from now on, or after that number."""
    feed = EventFeed(loop.bench.store, loop.bench.database)
    after = loop.bench.store.last_event_id() if after is None else after
    following = asyncio.create_task(loop.experiments.follow(feed, after))
    yield
    feed.close()
    await following


async def attended(loop: Loop, number: int) -> DiagnosisDocument:
    """As soon as a person decides on its experiments."""
    await until(lambda: not loop.diagnoses.diagnosis(number).unattended)
    return loop.diagnoses.diagnosis(number)


async def test_what_happens_is_followed(loop: Loop) -> None:
    ends = {
        "test_mass": ("ambiguous", "joint_1: a test mass needs a person"),
        "reversal": ("ambiguous", "joint_1: the machine may not move: stopped by Ada: hold"),
        "wide": ("none", ""),
    }
    async with followed(loop):
        parent = await asyncio.to_thread(loop.done, "reversal", loop.new.model_copy(update={"unattended": False}))
        await asyncio.to_thread(loop.measured, parent, None)
        await until(lambda: len(loop.children()) == 1)
        await loop.bench.machine.stop("Ada", "hold")
        for kind, (verdict, cause) in ends.items():
            ended = await attended(loop, (await asyncio.to_thread(loop.done, kind, None, verdict)).id)
            assert ended.cause.startswith(cause)
            assert (bool(ended.cause), ended.experiment) == (bool(cause), None)


async def test_an_aborted_experiment_ends_the_loop_that_nobody_attends(loop: Loop) -> None:
    found = loop.done("reversal")
    sweeps = [NewSweep(spec=spec(1, (0.0, 0.0, 0.0)), mode=None)]
    campaign = loop.diagnoses.approve(found.id, "joint_1", "unattended", None, {}, sweeps)
    async with followed(loop):
        await asyncio.to_thread(loop.bench.store.move_campaign, campaign.id, lambda _: CampaignState.ABORTED)
        assert (await attended(loop, found.id)).cause == f"campaign {campaign.id} was aborted"


async def test_only_what_was_proposed_is_approved(loop: Loop) -> None:
    nothing, weighing, waiting = loop.done(None), loop.done("test_mass"), loop.diagnoses.add(loop.new)
    for diagnosis, refusal, told in (
        (nothing, Conflict, "proposes no experiment for joint_1"),
        (weighing, BadInput, "give the mass that is mounted"),
        (waiting, Conflict, "an experiment requires a diagnosis that is done"),
    ):
        with pytest.raises(refusal, match=told):
            await loop.experiments.approve(diagnosis.id, "joint_1", "Ada", None, "workshop", loop.bench.intention)
    assert [one.experiment for one in loop.diagnoses.diagnoses()] == [None] * 3
