"""Sweeps of an imported campaign share revisions; a real worker process computes them."""

import asyncio
import os
import signal
from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import JsonValue

from service.jobs.jobs import MOST_REVISIONS, Jobs, open_groups, sweeps_a_revision
from service.jobs.worker import Worker, open_worker
from service.model.recording import Sweep
from service.model.robot import Robot
from service.store.database import open_database
from service.store.diagnoses import ModelStore
from service.store.documents import CampaignState, EventKind, SweepDocument, SweepState
from service.store.files.bundle import Bundle, save_bundle
from service.store.files.data_folder import import_campaign
from service.store.files.recordings import RecordingFiles
from service.store.store import Store
from tests.rigid_sweep import rigid_bundle
from tests.unit.service.campaigns.conftest import spec, until
from tests.unit.service.campaigns.diagnosis_bench import InProcess

pytestmark = pytest.mark.slow

SWEEPS = 7


@dataclass
class Import:
    """A data folder with one imported campaign."""

    store: Store
    files: RecordingFiles
    jobs: Jobs
    worker: Worker
    campaign: int

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
    async with opened(_new(folder), bundle) as there:
        await there.jobs.submit_imported(there.campaign)
        await there.completed()
        return there.revisions(), there.store.estimate(there.campaign).document


@pytest.fixture
def three_revisions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.jobs.jobs.MOST_REVISIONS", 3)


def test_how_many_sweeps_share_a_revision_depends_on_their_number_alone() -> None:
    sizes = [sweeps_a_revision(count) for count in (1, MOST_REVISIONS, MOST_REVISIONS + 1, 900, 901, 20_000)]
    assert sizes == [1, 1, 2, 15, 16, 334]
    for count in range(1, 400):
        groups = open_groups(_recorded(range(1, count + 1)))
        assert [sweep.number for group in groups for sweep in group] == list(range(1, count + 1))
        assert len(groups) <= MOST_REVISIONS
        assert len({len(group) for group in groups[:-1]}) <= 1


def test_groups_are_the_same_where_a_part_is_done() -> None:
    whole = open_groups(_recorded(range(1, 131)))
    part = open_groups(_recorded(range(50, 131), count=130))
    assert [group[-1].number for group in part] == [group[-1].number for group in whole if group[-1].number >= 50]
    assert part[1:] == whole[-len(part) + 1 :]


@pytest.mark.usefixtures("three_revisions")
async def test_every_sweep_is_identified_once_and_some_have_a_revision(tmp_path: Path, robot: Robot) -> None:
    async with opened(tmp_path, rigid_bundle(robot, SWEEPS)) as there:
        await there.jobs.submit_imported(there.campaign)
        assert there.jobs.open == SWEEPS
        await there.completed()
        assert there.states() == [SweepState.IDENTIFIED] * SWEEPS
        assert there.revisions() == [(1, 3), (2, 6), (3, 7)]
        events = there.store.events(0, there.campaign)
        of_sweeps = [event.data["number"] for event in events if event.kind is EventKind.SWEEP]
        assert of_sweeps == list(range(1, SWEEPS + 1))
        assert [event.data for event in events if event.kind is EventKind.ESTIMATE] == [
            {"revision": revision, "sweep": sweep} for revision, sweep in there.revisions()
        ]
        assert len(there.store.spectra(there.campaign)) == SWEEPS
        assert [tuple(row[:2]) for row in there.store.confidences(there.campaign, ["joint_1"])] == there.revisions()


async def test_shared_revisions_have_the_numbers_of_single_ones(
    tmp_path: Path, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    bundle = rigid_bundle(robot, SWEEPS)
    revisions, single = await identified(tmp_path / "single", bundle)
    assert revisions == [(n, n) for n in range(1, SWEEPS + 1)]
    monkeypatch.setattr("service.jobs.jobs.MOST_REVISIONS", 2)
    revisions, shared = await identified(tmp_path / "shared", bundle)
    assert revisions == [(1, 4), (2, 7)]
    assert shared == single


@pytest.mark.usefixtures("three_revisions")
async def test_a_killed_worker_and_a_restart_lose_no_sweep_and_double_none(tmp_path: Path, robot: Robot) -> None:
    bundle = rigid_bundle(robot, SWEEPS)
    expected = await identified(tmp_path / "undisturbed", bundle)
    folder = _new(tmp_path / "disturbed")
    async with open_worker(None) as worker, opened(folder, bundle, worker) as there:
        (process,) = await worker.processes()
        await there.jobs.submit_imported(there.campaign)
        os.kill(process, signal.SIGKILL)
        await until(lambda: bool(there.revisions()))
    async with opened(folder) as there:
        await there.jobs.recover()
        await there.jobs.recover()  # as a restart at the wrong moment
        await there.completed()
        assert there.states() == [SweepState.IDENTIFIED] * SWEEPS
        assert (there.revisions(), there.store.estimate(there.campaign).document) == expected


@pytest.mark.usefixtures("three_revisions")
async def test_only_the_sweep_with_a_fault_fails(tmp_path: Path, robot: Robot) -> None:
    """Of the first group one recording is changed on the disk; in the second a channel is dead."""
    bundle = rigid_bundle(robot, SWEEPS)
    async with opened(
        tmp_path, replace(bundle, sweeps=tuple(_dead(sweep, "0005") for sweep in bundle.sweeps))
    ) as there:
        path = there.files.path(there.store.recording(there.campaign, 2))
        path.write_bytes(path.read_bytes()[:-1])
        await there.jobs.submit_imported(there.campaign)
        await asyncio.wait_for(there.completed(), 120)
        failed = {sweep.number: sweep.cause for sweep in there.store.sweeps(there.campaign) if sweep.cause}
        assert "recording file was changed" in failed[2]
        assert "is 0 at the line of 2 Hz" in failed[5]
        assert [state is SweepState.FAILED for state in there.states()] == [n in (2, 5) for n in range(1, SWEEPS + 1)]
        assert there.revisions() == [(1, 1), (2, 3), (3, 4), (4, 6), (5, 7)]
        document = there.store.estimate(there.campaign).document
    good = replace(bundle, sweeps=tuple(sweep for sweep in bundle.sweeps if sweep.spec.id not in ("0002", "0005")))
    assert document == (await identified(tmp_path / "good", good))[1]


def _new(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _dead(sweep: Sweep, id: str) -> Sweep:
    if sweep.spec.id != id:
        return sweep
    return replace(sweep, recording=replace(sweep.recording, effort=np.zeros_like(sweep.recording.effort)))


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
