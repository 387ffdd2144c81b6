"""From the recorded sweep to the estimate revision, once with a real worker process."""

import os
import pickle
import signal
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from service.identification.axis.known_effects import known_effects
from service.identification.estimation import estimate_document
from service.identification.spectra.frequency_response import spectrum
from service.jobs.worker import open_worker
from service.machine.execution.recording.recovery import recover
from service.model.results.revision import KnownModel, StoredModel
from service.model.robot import Robot
from service.planning.safety.envelope import Envelope
from service.store.diagnoses import DiagnosisStore, ModelStore
from service.store.documents import CampaignState, NewDiagnosis, SweepState
from service.store.files.data_folder import campaign_bundle
from tests.unit.service.campaigns.conftest import POSES, Bench, open_bench, until
from tests.unit.service.campaigns.diagnosis_bench import InProcess
from tests.unit.service.identification.known import model

pytestmark = pytest.mark.slow


async def completed(bench: Bench) -> None:
    await until(lambda: bench.now.state is CampaignState.COMPLETED)


async def test_every_sweep_gives_one_revision_whatever_happens_to_the_worker(
    tmp_path: Path, robot: Robot, envelope: Envelope
) -> None:
    async with open_worker(None) as worker, open_bench(tmp_path, robot, envelope, worker) as bench:
        await bench.start()
        await until(lambda: bench.now.sweeps.get(SweepState.IDENTIFIED, 0) >= 1)
        os.kill((await worker.processes())[0], signal.SIGKILL)
        await bench.over()
        for sweep in bench.store.sweeps(bench.campaign.id):  # twice, as after a restart at the wrong moment
            bench.jobs.submit(sweep)
        await completed(bench)
        await until(lambda: bench.jobs.open == 0)
        estimates = bench.store.estimates(bench.campaign.id)
        bundle = campaign_bundle(bench.store, bench.files, bench.campaign.id)
    assert [(e.revision, e.number) for e in estimates] == [(n, n) for n in range(1, len(POSES) + 1)]
    offline = estimate_document(bundle.robot, [spectrum(bundle.robot, sweep) for sweep in bundle.sweeps]).as_json()
    assert estimates[-1].document == offline


async def test_the_newest_accepted_model_enters_new_estimates_and_is_told(
    tmp_path: Path, robot: Robot, envelope: Envelope
) -> None:
    """A delay that nobody has: effort is taken earlier by it, and friction that falls with frequency appears."""
    told = model(joint_1={"measurement_delay": {"delay": (2e-3, 1e-5)}})
    async with open_bench(tmp_path, robot, envelope, InProcess()) as bench:
        diagnoses, models = DiagnosisStore(bench.database), ModelStore(bench.database)
        new = NewDiagnosis(robot_id=bench.campaign.robot_id, campaigns=(bench.campaign.id,), axes=("joint_1",))
        accepted = models.add(diagnoses.add(new).id, "Ada", told, None)
        await bench.start()
        await bench.over()
        await completed(bench)
        document: Any = bench.store.estimates(bench.campaign.id)[-1].document
        bundle = campaign_bundle(bench.store, bench.files, bench.campaign.id)
    source = {"id": accepted.id, "revision": 1}
    assert document["model"] == source
    (effect,) = document["effects"]
    assert (effect["axis"], effect["effect"], effect["used"]) == ("joint_1", "measurement_delay", True)
    assert effect["parameters"]["delay"] == {"value": 2e-3, "std": pytest.approx(1e-5), "unit": "SI"}
    spectra = [spectrum(bundle.robot, sweep) for sweep in bundle.sweeps]
    known = known_effects(KnownModel.read(told, "model"), bundle.robot.joints, StoredModel(**source))
    assert document == estimate_document(bundle.robot, spectra, known=known).as_json()
    assert document["axes"] != estimate_document(bundle.robot, spectra).as_json()["axes"]


async def test_what_is_recorded_and_not_identified_is_taken_up_by_the_next_process(
    tmp_path: Path, robot: Robot, envelope: Envelope
) -> None:
    async with open_bench(tmp_path, robot, envelope) as bench:
        await bench.start()
        assert (await bench.over()).state is CampaignState.MEASURED
    async with open_bench(tmp_path, robot, envelope, InProcess()) as bench:
        recover(bench.store, bench.files)
        await bench.jobs.recover()
        await completed(bench)
        assert [e.number for e in bench.store.estimates(bench.campaign.id)] == [1, 2, 3, 4]


async def test_a_job_names_the_spectra_of_earlier_sweeps_and_carries_none(
    tmp_path: Path, robot: Robot, envelope: Envelope
) -> None:
    """What a job weighs must not grow with what was measured before it."""
    worker = InProcess()
    async with open_bench(tmp_path, robot, envelope, worker) as bench:
        await bench.start()
        await completed(bench)
        (first, *_) = bench.store.spectra(bench.campaign.id)
    weights = [len(pickle.dumps(job)) for job in worker.jobs]
    assert len(weights) == len(POSES)
    assert weights[-1] - weights[0] < 1000 * (len(POSES) - 1) < (tmp_path / first.path).stat().st_size


async def test_a_job_waits_while_the_database_is_locked(
    tmp_path: Path, robot: Robot, envelope: Envelope, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For longer than a transaction waits for its turn. Who asks is told, and nothing is done twice."""
    monkeypatch.setattr("service.store.engines.BUSY_TIMEOUT", 0.05)
    async with open_bench(tmp_path, robot, envelope) as bench:
        await bench.start()
        await bench.over()
    async with open_bench(tmp_path, robot, envelope, InProcess()) as bench:
        with closing(sqlite3.connect(tmp_path / "sweepid.sqlite", isolation_level=None)) as other:
            other.execute("BEGIN EXCLUSIVE")
            for sweep in bench.store.sweeps(bench.campaign.id):
                bench.jobs.submit(sweep)
            await until(lambda: bool(bench.jobs.troubles))
            assert "sweep 1 attempt 1: the database refused: database is locked" in bench.jobs.troubles[0]
            other.execute("ROLLBACK")
        await completed(bench)
        assert bench.jobs.troubles == ()
        assert [e.number for e in bench.store.estimates(bench.campaign.id)] == [1, 2, 3, 4]


async def test_a_sweep_whose_file_was_changed_fails_and_the_others_go_on(
    tmp_path: Path, robot: Robot, envelope: Envelope
) -> None:
    async with open_bench(tmp_path, robot, envelope) as bench:
        await bench.start()
        await bench.over()
        path = bench.files.path(bench.store.recording(bench.campaign.id, 2))
        path.write_bytes(path.read_bytes()[:-1])
    async with open_bench(tmp_path, robot, envelope, InProcess()) as bench:
        await bench.jobs.recover()
        await completed(bench)
        sweeps = bench.store.sweeps(bench.campaign.id)
        assert [sweep.state for sweep in sweeps] == [
            SweepState.IDENTIFIED,
            SweepState.FAILED,
            SweepState.IDENTIFIED,
            SweepState.IDENTIFIED,
        ]
        assert "recording file was changed" in sweeps[1].cause
        assert [e.number for e in bench.store.estimates(bench.campaign.id)] == [1, 3, 4]
        await until(lambda: bench.jobs.open == 0)
