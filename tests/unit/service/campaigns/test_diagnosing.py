"""From measured campaigns to a diagnosis, with a real worker process that dies and a service that is restarted; which
estimate it starts from.
"""

from functools import partial
from pathlib import Path
from typing import Any, cast

import pytest

from service import BadInput, Conflict
from service.diagnosis import axis_document, diagnose_axis
from service.diagnosis.experiments import MOST_EXPERIMENTS
from service.diagnosis.sensitivity import expected
from service.identification.design.diagnosis_sweeps import full_design
from service.identification.estimates.torque_gain import KnownMass
from service.identification.estimation import estimate_document, sweep_spectrum
from service.jobs.dask_workers import DaskWorkers
from service.jobs.diagnosing import Start, campaigns_of, recorded_sweeps
from service.jobs.experiments import accept_model
from service.jobs.work import DiagnosisJob
from service.jobs.worker import open_worker
from service.model import Robot
from service.model.configuration import read_cell
from service.planning.campaigns.state_machine import SweepEvent, sweep_move
from service.planning.diagnosis import ExperimentPlace
from service.planning.documents import ExperimentRequest
from service.planning.machine_setup import DriveAxis
from service.store.database import open_database
from service.store.documents import (
    BoltedMass,
    CampaignState,
    DiagnosisState,
    EstimateOf,
    NewDiagnosis,
    NewSweep,
    Weighing,
)
from service.store.files.bundle import Bundle, save_bundle
from service.store.files.data_folder import campaign_bundle, import_campaign
from service.store.files.recordings import RecordingFiles
from service.store.store import Store
from tests.unit.service.campaigns.conftest import SPECTRUM, until
from tests.unit.service.campaigns.diagnosis_bench import NOBODY, POSES, Bench, InProcess, axes_of, measured, open_bench
from tests.unit.service.diagnosis.following import following

pytestmark = pytest.mark.slow


WEAK = DriveAxis(joint="joint_1", effort_limit=0.01)


@pytest.mark.parametrize(
    ("drives", "before", "ended"),
    [
        ((), 0, ""),
        ((WEAK,), 0, "and the machine cannot run what may decide it (none of its sweeps can be run"),
        ((), MOST_EXPERIMENTS, f"after {MOST_EXPERIMENTS} experiments"),
    ],
)
async def test_an_experiment_is_proposed_if_the_machine_can_run_it_and_not_too_many_were_run(
    tmp_path: Path, robot: Robot, drives: tuple[DriveAxis, ...], before: int, ended: str
) -> None:
    place = ExperimentPlace(ExperimentRequest(robot_id=1), read_cell(Path("config/cells/workshop.yaml")), drives)
    async with open_bench(tmp_path, InProcess(), place) as bench:
        new = NewDiagnosis(robot_id=1, campaigns=(once(bench.store, bench.files, robot),), axes=("joint_1",))
        for _ in range(before):
            parent = bench.diagnoses.add(new)
            bench.diagnoses.finish(parent.id, {})
            sweeps = [NewSweep(spec=sweep.spec, mode=None) for sweep in bench.store.sweeps(new.campaigns[0])]
            bench.diagnoses.approve(parent.id, "joint_1", "Ada", None, {}, sweeps)
            new = new.model_copy(update={"parent": parent.id})
        diagnosis = bench.diagnoses.add(new)
        bench.diagnosing.submit(diagnosis)
        axis = (await bench.over(diagnosis.id)).found().axes["joint_1"]
    assert axis.verdict == "untestable"
    assert (axis.next_experiment is None) == bool(ended)
    assert ended in axis.summary
    assert ("It cannot be diagnosed further, because" in axis.summary) == bool(ended)


def once(store: Store, files: RecordingFiles, robot: Robot) -> int:
    """A campaign of joint_1 in one direction, not repeated."""
    designed = full_design(robot, "joint_1", POSES, repeats=1, sample_rate=250.0, blocks=("forward_slow",))
    sweeps = following(robot, "joint_1", designed)
    return import_campaign(store, files, save_bundle(files, Bundle(robot, tuple(sweeps)))).id


async def test_what_is_open_is_taken_up_by_the_next_process_and_what_is_done_is_not(
    tmp_path: Path, robot: Robot
) -> None:
    async with open_bench(tmp_path, DaskWorkers(NOBODY)) as bench:
        campaigns = [
            measured(bench.store, bench.files, robot, joint, seed) for seed, joint in enumerate(("joint_1", "joint_2"))
        ]
        diagnosis = await bench.diagnosing.request(campaigns, None, None, unattended=False)
        await until(lambda: bench.diagnoses.diagnosis(diagnosis.id).state is DiagnosisState.RUNNING)
        sweeps, _ = recorded_sweeps(bench.store, bench.files, campaigns_of(bench.store, campaigns), "joint_2")
        other = axis_document(diagnose_axis(robot, "joint_2", [sweep.read() for sweep in sweeps], twin=False)).as_json()
        before: Any = other | {"verdict": "none", "sentences": ["by the process before"]}
        bench.diagnoses.add_result(diagnosis.id, "joint_2", "none", before)
    async with open_worker(None) as worker, open_bench(tmp_path, worker) as bench:
        assert bench.diagnoses.diagnosis(diagnosis.id).axes == ("joint_1", "joint_2")
        await bench.diagnosing.recover()
        found = await bench.over(diagnosis.id)
    assert found.document is not None, found.cause
    assert found.verdicts == {"joint_2": "none", "joint_1": "named"}
    assert axes_of(found)["joint_2"] == before


async def test_the_mass_that_weighed_an_axis_counts_also_after_another_axis_was_weighed(
    tmp_path: Path, robot: Robot
) -> None:
    masses = [BoltedMass(mass=mass, center=(0.1, 0.0, 0.0)) for mass in (40.0, 20.0)]
    worker, joints = InProcess(), ("joint_1", "joint_2")
    async with open_bench(tmp_path, worker) as bench:
        bare = [measured(bench.store, bench.files, robot, joint, 1) for joint in joints]
        loaded = [
            measured(bench.store, bench.files, robot, joint, 2, KnownMass(mass.mass, mass.center))
            for joint, mass in zip(joints, masses, strict=True)
        ]
        parent: int | None = None
        for campaign, mass in zip(loaded, masses, strict=True):
            weighed = Weighing(campaign_id=campaign, mass=mass)
            new = NewDiagnosis(robot_id=1, campaigns=tuple(bare), axes=joints, weighed=weighed, parent=parent)
            parent = bench.diagnoses.add(new).id
        bench.diagnosing.submit(bench.diagnoses.diagnosis(parent or 0))
        await bench.over(parent or 0)
    jobs = [job for job in worker.jobs if isinstance(job, DiagnosisJob)]
    assert {job.joint: job.mass and job.mass.mass for job in jobs} == {"joint_1": 40.0, "joint_2": 20.0}
    for job, one, other in zip(jobs, bare, loaded, strict=True):
        assert [each.spec.id.split("/")[0] for each in (job.sweeps[0], job.weighed[0])] == [str(one), str(other)]
        assert [each.spec.block for each in job.weighed] == [each.spec.block for each in job.sweeps]


async def test_what_one_axis_came_to_is_kept_when_another_fails(tmp_path: Path, robot: Robot) -> None:
    async with open_bench(tmp_path, InProcess()) as bench:
        campaigns = [measured(bench.store, bench.files, robot, "joint_1", 1), dead(bench.store, bench.files, robot)]
        diagnosis = await bench.diagnosing.request(campaigns, None, None, unattended=False)
        found = await bench.over(diagnosis.id)
        with pytest.raises(Conflict, match=r"joint_2: has no result, joint_2: .*effort is 0 in every sample"):
            accept_model(bench.store, bench.diagnoses, bench.models, found.id, ["joint_2"], "Ada")
    assert (found.state, found.verdicts) == (DiagnosisState.FAILED, {"joint_1": "named"})
    assert "joint_2: effort is 0 in every sample of its sweeps" in found.cause
    assert found.document is not None
    assert list(axes_of(found)) == ["joint_1"]


def dead(store: Store, files: RecordingFiles, robot: Robot) -> int:
    """A campaign of joint_2 whose drive told no effort."""
    designed = full_design(robot, "joint_2", POSES[:1], sample_rate=250.0, blocks=("forward_slow",))
    sweeps = [expected(one, one.spec.pose[1]) for one in designed]
    for sweep in sweeps:
        sweep.recording.effort[:] = 0.0
    return import_campaign(store, files, save_bundle(files, Bundle(robot, tuple(sweeps)))).id


async def test_a_campaign_with_a_test_mass_is_no_evidence_of_the_bare_robot(tmp_path: Path, robot: Robot) -> None:
    async with open_bench(tmp_path, DaskWorkers(NOBODY)) as bench:
        bare = measured(bench.store, bench.files, robot, "joint_1", 1)
        parent = bench.diagnoses.add(NewDiagnosis(robot_id=1, campaigns=(bare,), axes=("joint_1",)))
        bench.diagnoses.finish(parent.id, {})
        sweeps = [NewSweep(spec=sweep.spec, mode=None) for sweep in bench.store.sweeps(bare)]
        mass = BoltedMass(mass=40.0, center=(0.1, 0.0, 0.0))
        loaded = bench.diagnoses.approve(parent.id, "joint_1", "Ada", mass, {}, sweeps)
        bench.store.move_campaign(loaded.id, lambda _: CampaignState.ABORTED)
        with pytest.raises(Conflict, match=f"campaign {loaded.id} was measured with a test mass of 40 kg"):
            await bench.diagnosing.request([bare, loaded.id], None, None, unattended=False)
        assert [one.id for one in bench.diagnoses.diagnoses()] == [parent.id]


async def test_a_model_keeps_what_others_accepted_meanwhile(tmp_path: Path, robot: Robot) -> None:
    """Two diagnoses from the nominal model, one an axis; then a third of an axis that has effects by now.

    A known effect that has changed may be accepted.
    """
    async with open_bench(tmp_path, InProcess()) as bench:
        accept = partial(accept_model, bench.store, bench.diagnoses, bench.models)

        async def diagnosed(joint: str, seed: int, model: int | None = None, coulomb: float = 60.0) -> int:
            campaign = measured(bench.store, bench.files, robot, joint, seed, coulomb=coulomb)
            begun = await bench.diagnosing.request([campaign], None, model, unattended=False)
            return (await bench.over(begun.id)).id

        ids = [await diagnosed(joint, seed) for joint, seed in (("joint_1", 1), ("joint_2", 2), ("joint_1", 3))]
        first, second = (accept(one, None, "Ada") for one in ids[:2])
        assert (second.revision, second.parent, list(axes_of(second))) == (2, first.id, ["joint_1", "joint_2"])
        assert axes_of(second)["joint_1"] == axes_of(first)["joint_1"]
        with pytest.raises(
            Conflict, match=f"joint_1: model {second.id} was accepted in the meantime.*diagnose again from model "
        ):
            accept(ids[2], None, "Ada")
        assert bench.models.newest(1) == second
        changed = await diagnosed("joint_1", 4, second.id, coulomb=80.0)
        assert bench.diagnoses.diagnosis(changed).verdicts == {"joint_1": "none"}
        found = [axes_of(model)["joint_1"]["effects"] for model in (first, accept(changed, None, "Ada"))]
    coulomb = [effect["parameters"]["coulomb"]["value"] for (effect,) in found]
    assert coulomb == pytest.approx([60.0, 80.0], abs=0.5)


def test_the_sweeps_of_two_campaigns_share_a_clock_and_no_repeats(tmp_path: Path, robot: Robot) -> None:
    with open_database(f"sqlite:///{tmp_path / 'sweepid.sqlite'}") as database:
        store, files = Store(database), RecordingFiles(tmp_path)
        first, second = (measured(store, files, robot, "joint_1", seed) for seed in (1, 2))
        sweeps, hashes = recorded_sweeps(store, files, campaigns_of(store, [second, first]), "joint_1")
        last = max(each.spec.started_at for each in store.sweeps(first))
        with pytest.raises(BadInput, match="campaign 99 does not exist"):
            campaigns_of(store, [99])
    starts = [sweep.spec.started_at for sweep in sweeps]
    assert starts == sorted(starts)
    half = len(sweeps) // 2
    assert starts[half] > last
    assert len(set(hashes)) == len(sweeps)
    assert [sweep.spec.id for sweep in sweeps[:2]] == [f"{first}/0001", f"{first}/0002"]
    slow = {"forward_slow", "backward_slow"}
    assert {sweep.spec.block for sweep in sweeps[:half]} == slow | {f"revisit_{block}" for block in slow}
    assert {sweep.spec.block for sweep in sweeps[half:]} == {
        f"{sweep.spec.block} of campaign {second}" for sweep in sweeps[:half]
    }


async def test_the_rigid_model_starts_from_the_robots_latest_estimate_that_is_no_evidence(
    tmp_path: Path, robot: Robot
) -> None:
    worker = InProcess()
    async with open_bench(tmp_path, worker) as bench:
        first, second = (measured(bench.store, bench.files, robot, "joint_1", seed) for seed in (1, 2))
        request = bench.diagnosing.request
        before = await request([second], None, None, unattended=False)
        assert before.estimate is None  # there is none yet
        identified(bench, robot, first, over=False)
        before = await request([second], None, None, unattended=False)
        assert before.estimate is None  # a better one may follow
        bench.store.move_campaign(first, lambda _: CampaignState.COMPLETED)
        told = EstimateOf(campaign_id=first, revision=1)
        other, same, both, asked = [
            await request(campaigns, None, None, unattended=False, start=start)
            for campaigns, start in (
                ([second], Start.ESTIMATE),
                ([first], Start.ESTIMATE),
                ([first, second], Start.ESTIMATE),
                ([second], Start.CAD),
            )
        ]
        assert [one.estimate for one in (other, same, both, asked)] == [told, None, None, None]
        assert bench.diagnoses.diagnosis(other.id).estimate == told
        found = await bench.over(other.id)
        assert axes_of(found)["joint_1"]["started_from"] == f"campaign {first}, revision 1"


async def test_an_estimate_that_does_not_fit_or_is_a_daily_check_of_one_pose_is_passed_over(
    tmp_path: Path, robot: Robot
) -> None:
    async with open_bench(tmp_path, InProcess()) as bench:
        whole, daily, broken, again, asked = (measured(bench.store, bench.files, robot, "joint_1", n) for n in range(5))

        async def start() -> EstimateOf | None:
            return (await bench.diagnosing.request([asked], None, None, unattended=False)).estimate

        identified(bench, robot, daily)
        identified(bench, robot, broken, {"base_parameters": []})
        assert await start() == EstimateOf(campaign_id=daily, revision=1)
        identified(bench, robot, whole, confidence=0.5)
        identified(bench, robot, again)  # newer than the one that knows J
        assert await start() == EstimateOf(campaign_id=whole, revision=1)


def identified(
    bench: Bench,
    robot: Robot,
    campaign: int,
    change: dict[str, Any] | None = None,
    *,
    over: bool = True,
    confidence: float | None = None,
) -> None:
    """The estimate of a campaign, as if it had come with its last sweep; its poses leave J open unless `confidence`."""
    sweeps = campaign_bundle(bench.store, bench.files, campaign).sweeps
    document = estimate_document(robot, [sweep_spectrum(robot, sweep) for sweep in sweeps]).as_json() | (change or {})
    cast("dict[str, Any]", document["axes"])["joint_1"]["confidence_percent"] = confidence
    last = bench.store.sweeps(campaign)[-1]
    assert bench.store.add_estimate([(last, SPECTRUM)], sweep_move(SweepEvent.IDENTIFY), document) is not None
    if over:
        bench.store.move_campaign(campaign, lambda _: CampaignState.COMPLETED)
