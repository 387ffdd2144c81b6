"""Fan-out of live samples, and the event feed."""

import asyncio
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from sqlalchemy import text
from structlog.testing import capture_logs

from drivers.ports import SampleBlock
from service.planning.campaigns.live import EventFeed, LiveBlock, LiveHub, thin
from service.store.database import open_database
from service.store.lease_and_latch import StopLatch
from service.store.store import Store
from service.web.api.live import message, text as json_text
from tests.unit.service.campaigns.conftest import until

TIMEOUT = 60.0  # s


def block(start: int, count: int = 100, rate: float = 1000.0) -> SampleBlock:
    index = np.arange(start, start + count)
    ramp = index.astype(float)
    return SampleBlock("joint_1", index, index / rate, ramp, 2 * ramp, 3 * ramp, ramp)


async def test_every_subscriber_of_the_campaign_gets_the_samples_and_nobody_else() -> None:
    """One that waits is woken, and one of a closed hub is done at once."""
    hub = LiveHub(rate=100.0)
    with hub.subscribe(1) as first, hub.subscribe(1) as second, hub.subscribe(2) as other:
        waiting = asyncio.create_task(anext(first))
        await asyncio.sleep(0)
        hub.publish(1, 7, block(0))
        live = await asyncio.wait_for(waiting, TIMEOUT)
        assert (live.number, len(live.time)) == (7, 10)
        hub.close()
        assert [live.number async for live in second] == [7]
        assert [live async for live in other] == []
    with hub.subscribe(1) as late:
        assert [live async for live in late] == []


async def test_a_slow_subscriber_loses_the_oldest_and_the_runner_does_not_wait() -> None:
    hub = LiveHub(rate=1000.0, depth=3)
    with hub.subscribe(1) as queue:
        for n in range(10):
            hub.publish(1, 1, block(100 * n))
        hub.close()
        assert [round(live.time[0], 6) async for live in queue] == [0.7, 0.8, 0.9]
        assert queue.dropped == 7


@pytest.mark.parametrize("form", [json_text, message])
async def test_a_block_is_encoded_once_for_all_subscribers(form: Callable[[LiveBlock], object]) -> None:
    hub = LiveHub(rate=100.0)
    with hub.subscribe(1) as first, hub.subscribe(1) as second:
        hub.publish(1, 7, block(0))
        hub.publish(1, 7, block(100))
        hub.close()
        sent = [form(one) async for one in first]
        again = [form(one) async for one in second]
    assert sent[0] != sent[1]
    assert all(one is other for one, other in zip(sent, again, strict=True))


def test_thinning_takes_means_and_never_makes_samples() -> None:
    live = thin(1, 1, block(0, count=25), rate=100.0)
    np.testing.assert_allclose(live.time, [4.5e-3, 14.5e-3, 22e-3])
    np.testing.assert_allclose(live.velocity, [9.0, 29.0, 44.0])
    assert [len(thin(1, 1, block(0, count), rate).time) for count, rate in ((1, 100.0), (5, 1e6))] == [1, 5]


def test_the_bytes_are_one_arrow_batch_with_its_place() -> None:
    content = message(thin(4, 2, block(0), rate=100.0))
    with pa.ipc.open_stream(content) as reader:
        table = reader.read_all()
    assert table.column_names == ["time", "effort", "velocity", "position"]
    assert table.num_rows == 10
    assert table.schema.metadata == {b"campaign": b"4", b"sweep": b"2", b"joint": b"joint_1"}


async def test_who_follows_loses_no_event_to_a_database_that_does_not_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.planning.campaigns.live.EventFeed.retry", 0.02)
    with open_database(f"sqlite:///{tmp_path / 'x.sqlite'}") as database:

        def rename(table: str, name: str) -> None:
            with database.write(quiet=True) as session:
                session.execute(text(f"ALTER TABLE {table} RENAME TO {name}"))

        latch = StopLatch(database)
        feed = EventFeed(Store(database), database)
        events = feed.follow(0)
        await asyncio.to_thread(latch.latch, "a", "told before")
        await asyncio.wait_for(anext(events), TIMEOUT)
        await asyncio.to_thread(rename, "event", "gone")
        waiting = asyncio.create_task(anext(events))
        with capture_logs() as logs:
            await until(lambda: bool(logs))
        assert logs[0]["event"] == "events_not_read"
        assert not waiting.done()
        await asyncio.to_thread(rename, "gone", "event")
        await asyncio.to_thread(latch.latch, "b", "comes later")
        assert (await asyncio.wait_for(waiting, TIMEOUT)).data["why"] == "comes later"
        await asyncio.to_thread(rename, "event", "gone")
        ending = asyncio.create_task(anext(events, None))
        with capture_logs() as logs:
            await until(lambda: bool(logs))
        feed.close()  # it ends also while it waits for the database
        assert await asyncio.wait_for(ending, TIMEOUT) is None
