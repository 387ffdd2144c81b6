"""From the recorded sweep to the estimate revision, of measured and imported campaigns, and again in batches."""

import asyncio
import os
import pickle
import signal
import sqlite3
from collections.abc import AsyncGenerator, Iterator, Sequence
from contextlib import asynccontextmanager, closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from pydantic import JsonValue

from service import BadInput
from service.identification.axis.known_effects import known_effects
from service.identification.estimation import estimate_document
from service.identification.spectra.frequency_response import spectrum
from service.jobs.jobs import MOST_REVISIONS, Jobs, open_groups, sweeps_a_revision
from service.jobs.work import Job, JobFailed, Work, Worker
from service.jobs.worker import open_worker
from service.machine.execution.sweep_samples import recover
from service.model import Robot
from service.model.results.effect import KnownModel, StoredModel
from service.model.results.estimate import Estimate
from service.planning.campaigns.live import EventFeed
from service.store.database import open_database
from service.store.diagnoses import DiagnosisStore, ModelStore
from service.store.documents import BatchState, CampaignState, EventKind, NewDiagnosis, SweepDocument, SweepState
from service.store.files.bundle import Bundle, save_bundle
from service.store.files.data_folder import campaign_bundle, import_campaign
from service.store.files.recordings import RecordingFiles
from service.store.store import Store
from tests.rigid_sweep import rigid_bundle
from tests.stored_archive import Archive, archive
from tests.unit.service.campaigns.conftest import POSES, Again, Bench, spec, until
from tests.unit.service.campaigns.diagnosis_bench import Answer, InProcess
from tests.unit.service.identification.known import model

pytestmark = pytest.mark.slow


async def completed(bench: Bench) -> None:
    await until(lambda: bench.now.state is CampaignState.COMPLETED)


@asynccontextmanager
async def identified_again(again: Again, worker: Worker) -> AsyncGenerator[Bench]:
    """A campaign that was measured and identified by this worker."""
    async with again(worker) as bench:
        await bench.start()
        await completed(bench)
        yield bench


async def test_the_newest_accepted_model_enters_new_estimates_and_is_told(again: Again, robot: Robot) -> None:
    """A delay that nobody has: effort is taken earlier by it, and friction that falls with frequency appears."""
    told = model(joint_1={"measurement_delay": {"delay": (2e-3, 1e-5)}})
    async with again(InProcess()) as bench:
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


async def test_what_is_recorded_and_not_identified_is_taken_up_by_the_next_process(again: Again) -> None:
    async with again() as bench:
        await bench.start()
        assert (await bench.over()).state is CampaignState.MEASURED
    async with again(InProcess()) as bench:
        recover(bench.store, bench.files)
        await bench.jobs.recover()
        await completed(bench)
        assert [e.number for e in bench.store.estimates(bench.campaign.id)] == [1, 2, 3, 4]


async def test_a_job_names_the_spectra_of_earlier_sweeps_and_carries_none(again: Again, tmp_path: Path) -> None:
    """What a job weighs must not grow with what was measured before it."""
    async with identified_again(again, worker := InProcess()) as bench:
        (first, *_) = bench.store.spectra(bench.campaign.id)
    weights = [len(pickle.dumps(job)) for job in worker.jobs]
    assert len(weights) == len(POSES)
    assert weights[-1] - weights[0] < 1000 * (len(POSES) - 1) < (tmp_path / first.path).stat().st_size


class Updating(InProcess):
    """Says of each revision with a new sweep that it is an update: as of a campaign that reaches its confidence."""

    async def run(self, job: Work[Answer]) -> Answer:
        answer: Any = await super().run(job)
        if isinstance(job, Job) and job.sweeps:
            return replace(answer, estimate=answer.estimate | {"updates": 1})
        return answer


async def test_a_campaign_ends_with_a_fit_of_all_its_sweeps(again: Again) -> None:
    async with identified_again(again, Updating()) as bench:
        *_, before, last = bench.store.estimates(bench.campaign.id)
        bundle = campaign_bundle(bench.store, bench.files, bench.campaign.id)
    assert (last.revision, before.document["updates"]) == (len(POSES), 1)
    spectra = [spectrum(bundle.robot, sweep) for sweep in bundle.sweeps]
    assert last.document == estimate_document(bundle.robot, spectra).as_json()


class Unfit(Updating):
    """Fails to fit all sweeps at once."""

    async def run(self, job: Work[Answer]) -> Answer:
        if isinstance(job, Job) and not job.sweeps:
            raise JobFailed("a worker without memory")
        answer: Any = await super().run(job)
        return answer


async def test_a_fit_of_all_that_fails_ends_the_campaign_and_its_estimate_still_says_that_it_is_an_update(
    again: Again,
) -> None:
    async with identified_again(again, Unfit()) as bench:
        assert bench.store.estimate(bench.campaign.id).document["updates"] == 1


async def test_an_aborted_campaign_ends_with_a_fit_of_all_its_sweeps(again: Again, tmp_path: Path) -> None:
    """Also if every sweep was identified before: no job follows. The service of another machine leaves it alone."""
    url, elsewhere = f"sqlite:///{tmp_path / 'sweepid.sqlite'}", InProcess()
    async with again(Updating()) as bench:
        with open_database(url, machine="another") as database:
            other = Jobs(Store(database), bench.files, elsewhere, ModelStore(database))
            feed = EventFeed(bench.store, bench.database)
            following = asyncio.gather(bench.jobs.follow(feed, 0), other.follow(feed, 0))
            await bench.in_a_sweep()
            bench.drive.go.set()
            bench.drive.go.clear()  # the next sweep is held
            await until(lambda: bench.now.sweeps.get(SweepState.IDENTIFIED, 0) >= 1)
            await bench.runner.abort(bench.campaign.id, "enough")
            await until(lambda: "updates" not in bench.store.estimate(bench.campaign.id).document)
            await until(lambda: bench.jobs.open == 0)
            assert bench.now.state is CampaignState.ABORTED
            feed.close()
            await following
            assert (other.open, other.troubles, elsewhere.jobs) == (0, (), [])


async def test_a_job_waits_while_the_database_is_locked(
    again: Again, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For longer than a transaction waits for its turn. Who asks is told, and nothing is done twice."""
    monkeypatch.setattr("service.store.database.BUSY_TIMEOUT", 0.05)
    async with again() as bench:
        await bench.start()
        await bench.over()
    async with again(InProcess()) as bench:
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


SWEEPS = 7


@dataclass
class Import:
    """A data folder with one imported campaign."""

    store: Store
    files: RecordingFiles
    jobs: Jobs
    worker: Worker
    campaign: int

    async def identify(self) -> None:
        await self.jobs.submit_imported(self.campaign)
        await self.completed()

    async def completed(self) -> None:
        await until(lambda: self.store.campaign(self.campaign).state is CampaignState.COMPLETED)
        await until(lambda: self.jobs.open == 0)

    def states(self) -> list[SweepState]:
        return [sweep.state for sweep in self.store.sweeps(self.campaign)]

    def revisions(self) -> list[tuple[int, int]]:
        """Each with its sweep."""
        return [(one.revision, one.number) for one in self.store.estimates(self.campaign)]


@asynccontextmanager
async def opened(folder: Path, bundle: Bundle | None = None, worker: Worker | None = None) -> AsyncGenerator[Import]:
    """The folder with a worker; `bundle` is imported first, and nothing is identified yet."""
    with open_database(f"sqlite:///{folder / 'sweepid.sqlite'}") as database:
        store, files = Store(database), RecordingFiles(folder)
        if bundle is not None:
            import_campaign(store, files, save_bundle(files, bundle))
        worker = worker or InProcess()
        jobs = Jobs(store, files, worker, ModelStore(database))
        yield Import(store, files, jobs, worker, store.campaigns()[0].id)
        await jobs.close()


async def identified(folder: Path, bundle: Bundle) -> tuple[list[tuple[int, int]], dict[str, JsonValue]]:
    """Revisions with their sweeps, and the last document."""
    async with opened(folder, bundle) as there:
        await there.identify()
        return there.revisions(), there.store.estimate(there.campaign).document


@pytest.fixture
def three_revisions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.jobs.jobs.MOST_REVISIONS", 3)


def test_how_many_sweeps_share_a_revision_depends_on_their_number_alone() -> None:
    sizes = [sweeps_a_revision(count) for count in (1, MOST_REVISIONS, MOST_REVISIONS + 1, 900, 901, 20_000)]
    assert sizes == [1, 1, 2, 15, 16, 334]
    for count in (*range(1, 130), 259, 400):
        groups = open_groups(_recorded(range(1, count + 1)))
        assert [sweep.number for group in groups for sweep in group] == list(range(1, count + 1))
        assert len(groups) <= MOST_REVISIONS
        assert len({len(group) for group in groups[:-1]}) <= 1


def test_groups_are_the_same_where_a_part_is_done() -> None:
    whole = open_groups(_recorded(range(1, 131)))
    part = open_groups(_recorded(range(50, 131), count=130))
    assert [group[-1].number for group in part] == [group[-1].number for group in whole if group[-1].number >= 50]
    assert part[1:] == whole[-len(part) + 1 :]


async def test_every_sweep_is_identified_once_and_some_have_a_revision(
    tmp_path: Path, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Shared revisions have the numbers of single ones."""
    bundle = rigid_bundle(robot, SWEEPS)
    revisions, single = await identified(tmp_path / "single", bundle)
    assert revisions == [(n, n) for n in range(1, SWEEPS + 1)]
    monkeypatch.setattr("service.jobs.jobs.MOST_REVISIONS", 3)
    async with opened(tmp_path, bundle) as there:
        await there.jobs.submit_imported(there.campaign)
        assert there.jobs.open == SWEEPS
        await there.completed()
        assert there.states() == [SweepState.IDENTIFIED] * SWEEPS
        assert there.revisions() == [(1, 3), (2, 6), (3, 7)]
        assert there.store.estimate(there.campaign).document == single
        events = there.store.events(0, there.campaign)
        of_sweeps = [event.data["number"] for event in events if event.kind is EventKind.SWEEP]
        assert of_sweeps == list(range(1, SWEEPS + 1))
        assert [event.data for event in events if event.kind is EventKind.ESTIMATE] == [
            {"revision": revision, "sweep": sweep} for revision, sweep in there.revisions()
        ]
        assert len(there.store.spectra(there.campaign)) == SWEEPS
        assert [tuple(row[:2]) for row in there.store.confidences(there.campaign, ["joint_1"])] == there.revisions()


@pytest.mark.usefixtures("three_revisions")
async def test_a_killed_worker_and_a_restart_lose_no_sweep_and_double_none(tmp_path: Path, robot: Robot) -> None:
    bundle = rigid_bundle(robot, SWEEPS)
    expected = await identified(tmp_path / "undisturbed", bundle)
    async with open_worker(None) as worker, opened(tmp_path, bundle, worker) as there:
        (process,) = await worker.processes()
        await there.jobs.submit_imported(there.campaign)
        os.kill(process, signal.SIGKILL)
        await until(lambda: bool(there.revisions()))
    async with opened(tmp_path) as there:
        await there.jobs.recover()
        await there.jobs.recover()  # as a restart at the wrong moment
        await there.completed()
        assert there.states() == [SweepState.IDENTIFIED] * SWEEPS
        assert (there.revisions(), there.store.estimate(there.campaign).document) == expected


@pytest.mark.usefixtures("three_revisions")
async def test_only_the_sweep_with_a_fault_fails(tmp_path: Path, robot: Robot) -> None:
    """Of the first group one recording is changed on the disk; in the second a channel is dead."""
    bundle = rigid_bundle(robot, SWEEPS)
    good = replace(bundle, sweeps=tuple(sweep for sweep in bundle.sweeps if sweep.spec.id not in ("0002", "0005")))
    expected = await identified(tmp_path / "good", good)
    (dead,) = (sweep for sweep in bundle.sweeps if sweep.spec.id == "0005")
    dead.recording.effort[:] = 0.0
    async with opened(tmp_path, bundle) as there:
        path = there.files.path(there.store.recording(there.campaign, 2))
        path.write_bytes(path.read_bytes()[:-1])
        await asyncio.wait_for(there.identify(), 120)
        failed = {sweep.number: sweep.cause for sweep in there.store.sweeps(there.campaign) if sweep.cause}
        assert "recording file was changed" in failed[2]
        assert "is 0 at the line of 2 Hz" in failed[5]
        assert [state is SweepState.FAILED for state in there.states()] == [n in (2, 5) for n in range(1, SWEEPS + 1)]
        assert there.revisions() == [(1, 1), (2, 3), (3, 4), (4, 6), (5, 7)]
        assert there.store.estimate(there.campaign).document == expected[1]


def _recorded(numbers: Sequence[int], count: int | None = None) -> list[SweepDocument]:
    """`count` sweeps, of which these wait to be identified."""
    return [
        SweepDocument(
            campaign_id=1,
            number=number,
            spec=spec(number, (0.0, 0.0, 0.0)),
            mode=None,
            state=SweepState.RECORDED if number in numbers else SweepState.IDENTIFIED,
            cause="",
            attempt=1,
        )
        for number in range(1, (count or len(numbers)) + 1)
    ]


CAMPAIGNS, STORED_POSES = 4, 2
PATIENCE = 600.0  # s


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Archive]:
    """Identified by the service's own worker process."""

    async def identify(found: Archive) -> None:
        async with open_worker(None) as worker:
            await asyncio.wait_for(found.identify(worker), PATIENCE)

    with archive(tmp_path_factory.mktemp("archive"), CAMPAIGNS, STORED_POSES) as found:
        asyncio.run(identify(found))
        yield found


def check_same(stored: Archive, number: int) -> None:
    """Every campaign has one result, which is the stored estimate to 1e-9."""
    results = stored.batches.results(number)
    assert [(one.campaign_id, one.cause) for one in results] == [(campaign, "") for campaign in stored.campaigns]
    for one in results:
        new = Estimate.read(stored.batches.result(number, one.campaign_id).document, "new")
        old = stored.store.estimate(one.campaign_id).content
        for joint, axis in old.axes.items():
            now = new.axes[joint].inertia
            assert [sweep.sweep for sweep in axis.inertia] == [sweep.sweep for sweep in now]
            for name in ("value", "std"):
                expected = [getattr(sweep, name) for sweep in axis.inertia]
                assert [getattr(sweep, name) for sweep in now] == pytest.approx(expected, rel=1e-9)
        expected = [parameter.value for parameter in old.base_parameters]
        assert [parameter.value for parameter in new.base_parameters] == pytest.approx(expected, rel=1e-9, abs=1e-9)


async def test_one_worker_finds_the_same_and_the_next_process_goes_on(stored: Archive) -> None:
    async with open_worker(None) as worker:
        async with stored.service(worker) as batches:
            number = (await batches.request(None, "Ada")).id
            await until(lambda: stored.batches.batch(number).done > 0)
        left = stored.batches.batch(number)
        assert left.state is BatchState.RUNNING
        async with stored.service(worker) as batches:
            await batches.recover()
            await asyncio.wait_for(stored.over(number), PATIENCE)
    assert stored.batches.batch(number).state is BatchState.DONE
    check_same(stored, number)


async def test_a_cancelled_batch_computes_no_more(stored: Archive) -> None:
    async with open_worker(None) as worker, stored.service(worker) as batches:
        number = (await batches.request(None, "Ada")).id
        await until(lambda: stored.batches.batch(number).done > 0)
        cancelled = await batches.cancel(number)
        assert batches.open == 0 or cancelled.state is BatchState.CANCELLED
        again = await asyncio.wait_for(stored.again(worker, stored.campaigns[:1]), PATIENCE)  # and the worker is free
    assert stored.batches.batch(number) == cancelled
    assert stored.batches.batch(again).done == 1


async def test_a_recording_that_was_changed_is_a_cause_and_stops_no_other(stored: Archive) -> None:
    path = stored.files.path(stored.store.recording(stored.campaigns[1], 1))
    content = path.read_bytes()
    path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    try:
        async with open_worker(None) as worker:
            number = await asyncio.wait_for(stored.again(worker, stored.campaigns[:2]), PATIENCE)
    finally:
        path.write_bytes(content)
    good, bad = stored.batches.results(number)
    assert (good.cause, good.sweeps) == ("", 2 * STORED_POSES)
    assert "recording file was changed" in bad.cause
    assert stored.batches.batch(number).failed == 1


async def test_what_cannot_be_identified_again_is_refused(stored: Archive) -> None:
    plan = stored.store.add_plan(stored.store.campaign(stored.campaigns[0]).robot_id, {})
    campaign = stored.store.add_campaign(plan.id, [])
    with pytest.raises(BadInput, match="has not ended, or has no identified sweep"):
        stored.batches.add([campaign.id], "Ada")
