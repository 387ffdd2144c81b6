"""Campaigns identified again: by four workers as by one, and whatever dies meanwhile."""

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.jobs.worker import open_worker
from service.model.errors import BadInput
from service.model.results.estimate import Estimate
from service.store.documents import BatchState
from tests.programs import needs
from tests.stored_archive import Archive, archive
from tests.unit.service.campaigns.conftest import until
from tests.unit.service.cluster import DaskProcesses, certificates

pytestmark = pytest.mark.slow
CAMPAIGNS, POSES = 6, 3
PATIENCE = 600.0  # s


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Archive]:
    """Identified by the service's own worker process."""

    async def identify(found: Archive) -> None:
        async with open_worker(None) as worker:
            await asyncio.wait_for(found.identify(worker), PATIENCE)

    with archive(tmp_path_factory.mktemp("archive"), CAMPAIGNS, POSES) as found:
        asyncio.run(identify(found))
        yield found


def check_same(stored: Archive, number: int) -> None:
    """Every campaign has one result, which is the stored estimate to 1e-9."""
    results = stored.batches.results(number)
    assert [one.campaign_id for one in results] == list(stored.campaigns)
    assert {one.cause for one in results} == {""}
    for one in results:
        new = Estimate.read(stored.batches.result(number, one.campaign_id).document, "new")
        old = stored.store.estimate(one.campaign_id).content
        for joint, axis in old.axes.items():
            assert [sweep.sweep for sweep in axis.inertia] == [sweep.sweep for sweep in new.axes[joint].inertia]
            for before, now in zip(axis.inertia, new.axes[joint].inertia, strict=True):
                assert now.value == pytest.approx(before.value, rel=1e-9)
                assert now.std == pytest.approx(before.std, rel=1e-9)
        for before, now in zip(old.base_parameters, new.base_parameters, strict=True):
            assert now.value == pytest.approx(before.value, rel=1e-9, abs=1e-9)


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


@needs("openssl")
async def test_four_workers_find_the_same_although_one_is_killed(stored: Archive, tmp_path: Path) -> None:
    dask = DaskProcesses.at_free_port(tmp_path, certificates(tmp_path / "authority", "plant"))
    try:
        dask.start_scheduler()
        for _ in range(4):
            dask.start_worker()
        async with open_worker(dask.cluster) as worker, stored.service(worker) as batches:
            while len(await worker.processes()) < 4:  # noqa: ASYNC110
                await asyncio.sleep(0.1)
            number = (await batches.request(None, "Ada")).id
            dask.workers[0].kill()
            await asyncio.wait_for(stored.over(number), PATIENCE)
    finally:
        dask.close()
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
    assert (good.cause, good.sweeps) == ("", 2 * POSES)
    assert "recording file was changed" in bad.cause
    assert stored.batches.batch(number).failed == 1


async def test_what_cannot_be_identified_again_is_refused(stored: Archive) -> None:
    plan = stored.store.add_plan(stored.store.campaign(stored.campaigns[0]).robot_id, {})
    campaign = stored.store.add_campaign(plan.id, [])
    with pytest.raises(BadInput, match="has not ended, or has no identified sweep"):
        stored.batches.add([campaign.id], "Ada")
