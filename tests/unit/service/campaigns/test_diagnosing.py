"""From measured campaigns to a diagnosis, with a real worker process that dies and a service that is restarted."""

import asyncio
import os
import signal
from collections.abc import AsyncGenerator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import psutil
import pytest

from service.campaigns.diagnosing import Diagnosing
from service.campaigns.evidence import campaigns_of, recorded_sweeps
from service.diagnosis import axis_document, diagnose_axis
from service.diagnosis.design import full_design
from service.diagnosis.prospect import expected
from service.errors import BadInput
from service.identification.regressor import inertia_rows
from service.identification.torque_gain import KnownMass
from service.recording import Sweep
from service.robot import Robot
from service.store.bundle import Bundle
from service.store.database import open_database
from service.store.diagnoses import DiagnosisStore
from service.store.diagnosis_documents import BoltedMass, DiagnosisDocument, DiagnosisState, NewDiagnosis, Weighing
from service.store.exchange import import_campaign
from service.store.model_revisions import ModelStore
from service.store.recordings import RecordingFiles
from service.store.store import Store
from service.worker import DiagnosisJob, Work, Worker, open_worker

POSES = np.array([[0.0, -0.6, 0.4, 0.0, 0.0, 0.0], [0.5, 0.4, -0.7, 0.0, 0.0, 0.0]])
PATIENCE = 300.0  # s; the worker gives way to whatever else the computer does
NOBODY = "tcp://127.0.0.1:1"  # a scheduler that does not answer

Answer = TypeVar("Answer")


def measured(
    store: Store, files: RecordingFiles, robot: Robot, joint: str, seed: int, mass: KnownMass | None = None
) -> int:
    """A campaign of slow sweeps of one axis with dry friction, and with a mass on the last link; its number."""
    random, index = np.random.default_rng(seed), robot.index(joint)
    body = np.zeros(robot.chain.inertial.size)
    if mass is not None:
        body[-10:] = mass.parameters
    sweeps: list[Sweep] = []
    for designed in full_design(robot, joint, POSES, sample_rate=250.0, blocks=("forward_slow", "backward_slow")):
        sweep = expected(designed, designed.spec.pose[index])
        record = sweep.recording
        inertia = 300.0 + float((inertia_rows(robot.chain, index, np.array([sweep.spec.pose])) @ body)[0])
        friction = 200.0 * record.velocity + 60.0 * np.sign(record.velocity)
        noise = random.normal(0, 3.0, len(record.time))
        record.effort[:] = inertia * np.gradient(record.velocity, record.time) + friction + noise
        sweeps.append(sweep)
    return import_campaign(store, files, Bundle(robot, tuple(sweeps))).id


class InProcess(Worker):
    """Does jobs at once and keeps them."""

    def __init__(self) -> None:
        super().__init__(NOBODY)
        self.jobs: list[Work[Any]] = []

    async def run(self, job: Work[Answer]) -> Answer:
        self.jobs.append(job)
        return await asyncio.to_thread(job)


@dataclass
class Bench:
    store: Store
    files: RecordingFiles
    diagnoses: DiagnosisStore
    diagnosing: Diagnosing

    async def over(self, diagnosis_id: int) -> DiagnosisDocument:
        ended = (DiagnosisState.DONE, DiagnosisState.FAILED)
        await until(lambda: self.diagnoses.diagnosis(diagnosis_id).state in ended)
        return self.diagnoses.diagnosis(diagnosis_id)


@asynccontextmanager
async def open_bench(folder: Path, worker: Worker) -> AsyncGenerator[Bench]:
    async with AsyncExitStack() as stack:
        database = stack.enter_context(open_database(f"sqlite:///{folder / 'sweepid.sqlite'}"))
        store, files, diagnoses = Store(database), RecordingFiles(folder), DiagnosisStore(database)
        diagnosing = Diagnosing(store, diagnoses, ModelStore(database), files, worker)
        stack.push_async_callback(diagnosing.close)
        yield Bench(store, files, diagnoses, diagnosing)


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(PATIENCE):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.02)


async def test_a_worker_killed_in_the_middle_changes_nothing(tmp_path: Path, robot: Robot) -> None:
    async with open_worker(None) as worker, open_bench(tmp_path, worker) as bench:
        campaign = measured(bench.store, bench.files, robot, "joint_1", 1)
        (pid,) = await worker.processes()
        idle = sum(psutil.Process(pid).cpu_times()[:2])
        diagnosis = await bench.diagnosing.request([campaign], None, None, unattended=False)
        await until(lambda: sum(psutil.Process(pid).cpu_times()[:2]) > idle + 0.2)
        assert bench.diagnoses.diagnosis(diagnosis.id).state is DiagnosisState.RUNNING
        os.kill(pid, signal.SIGKILL)
        found = await bench.over(diagnosis.id)
        sweeps, _ = recorded_sweeps(bench.store, bench.files, campaigns_of(bench.store, [campaign]), "joint_1")
    offline = axis_document(diagnose_axis(robot, "joint_1", [sweep.read() for sweep in sweeps]))
    assert found.document is not None, found.cause
    assert found.document["axes"] == {"joint_1": offline}
    assert found.verdicts == {"joint_1": "named"}


async def test_what_is_open_is_taken_up_by_the_next_process_and_what_is_done_is_not(
    tmp_path: Path, robot: Robot
) -> None:
    async with open_bench(tmp_path, Worker(NOBODY)) as bench:
        campaigns = [
            measured(bench.store, bench.files, robot, joint, seed) for seed, joint in enumerate(("joint_1", "joint_2"))
        ]
        diagnosis = await bench.diagnosing.request(campaigns, None, None, unattended=False)
        await until(lambda: bench.diagnoses.diagnosis(diagnosis.id).state is DiagnosisState.RUNNING)
        sweeps, _ = recorded_sweeps(bench.store, bench.files, campaigns_of(bench.store, campaigns), "joint_2")
        other = axis_document(diagnose_axis(robot, "joint_2", [sweep.read() for sweep in sweeps], twin=False))
        before = other | {"verdict": "none", "sentences": ["by the process before"]}
        bench.diagnoses.add_result(diagnosis.id, "joint_2", "none", before)
    async with open_worker(None) as worker, open_bench(tmp_path, worker) as bench:
        assert bench.diagnoses.diagnosis(diagnosis.id).axes == ("joint_1", "joint_2")
        await bench.diagnosing.recover()
        found = await bench.over(diagnosis.id)
    assert found.document is not None, found.cause
    assert found.verdicts == {"joint_2": "none", "joint_1": "named"}
    assert found.document["axes"]["joint_2"] == before


async def test_a_recording_that_was_changed_fails_the_diagnosis(tmp_path: Path, robot: Robot) -> None:
    async with open_bench(tmp_path, Worker(NOBODY)) as bench:
        campaign = measured(bench.store, bench.files, robot, "joint_1", 1)
        path = bench.files.path(bench.store.recording(campaign, 2))
        path.write_bytes(path.read_bytes()[:-1])
        diagnosis = await bench.diagnosing.request([campaign], None, None, unattended=False)
        found = await bench.over(diagnosis.id)
    assert found.state is DiagnosisState.FAILED
    assert "recording file was changed" in found.cause


async def test_a_known_mass_stands_beside_the_evidence(tmp_path: Path, robot: Robot) -> None:
    mass = BoltedMass(mass=40.0, center=(0.1, 0.0, 0.0))
    worker = InProcess()
    async with open_bench(tmp_path, worker) as bench:
        known = KnownMass(mass.mass, mass.center)
        bare, loaded = (
            measured(bench.store, bench.files, robot, "joint_1", seed, bolted)
            for seed, bolted in ((1, None), (2, known))
        )
        weighed = Weighing(campaign_id=loaded, mass=mass)
        new = NewDiagnosis(robot_id=1, campaigns=(bare,), axes=("joint_1",), weighed=weighed)
        diagnosis = bench.diagnoses.add(new)
        bench.diagnosing.submit(diagnosis)
        found = await bench.over(diagnosis.id)
    (job,) = worker.jobs
    assert isinstance(job, DiagnosisJob)
    assert job.mass == known
    assert [sweep.spec.id.split("/")[0] for sweep in (job.sweeps[0], job.weighed[0])] == [str(bare), str(loaded)]
    assert [sweep.spec.block for sweep in job.weighed] == [sweep.spec.block for sweep in job.sweeps]
    assert found.document is not None, found.cause
    named = [effect["effect"] for effect in found.document["axes"]["joint_1"]["effects"]]
    assert (found.verdicts, named) == ({"joint_1": "named"}, ["coulomb_friction"])


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
