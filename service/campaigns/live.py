"""Live data for subscribers, in the service's event loop: samples of running sweeps, and events of the outbox.

The runner never waits for a subscriber: every queue is bounded and drops its oldest block.
"""

import asyncio
from collections import deque
from collections.abc import AsyncGenerator, Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pyarrow as pa
import structlog
from numpy.typing import NDArray
from sqlalchemy.exc import SQLAlchemyError

from drivers.ports import SampleBlock
from service.store.database import Database, refusal
from service.store.documents import EventDocument
from service.store.store import Store

_log = structlog.get_logger(__name__)

Array = NDArray[np.float64]

RETRY = 2.0  # s until a database that refused is asked again

# pyarrow ships without types
_arrow = cast(Any, pa)


@dataclass(frozen=True, slots=True)
class LiveBlock:
    """Thinned samples of one block: arrays (n,), s and SI on the joint side."""

    campaign_id: int
    number: int
    joint: str
    time: Array
    effort: Array
    velocity: Array
    position: Array

    def to_arrow(self) -> bytes:
        """An Arrow IPC stream of one record batch; campaign, sweep and joint stand in the schema's metadata."""
        names = ("time", "effort", "velocity", "position")
        batch = _arrow.RecordBatch.from_arrays([_arrow.array(getattr(self, name)) for name in names], list(names))
        batch = batch.replace_schema_metadata(
            {"campaign": str(self.campaign_id), "sweep": str(self.number), "joint": self.joint}
        )
        sink = _arrow.BufferOutputStream()
        with _arrow.ipc.new_stream(sink, batch.schema) as writer:
            writer.write_batch(batch)
        return cast(bytes, sink.getvalue().to_pybytes())


class LiveQueue:
    """The blocks of one subscriber: ``async for block in queue``. `dropped` counts those it was too slow for."""

    def __init__(self, depth: int) -> None:
        self._blocks: deque[LiveBlock] = deque()
        self._depth = depth
        self._news = asyncio.Event()
        self._closed = False
        self.dropped = 0

    def put(self, block: LiveBlock) -> None:
        if len(self._blocks) == self._depth:
            self._blocks.popleft()
            self.dropped += 1
        self._blocks.append(block)
        self._news.set()

    def close(self) -> None:
        """The iteration ends after the blocks that are there."""
        self._closed = True
        self._news.set()

    def __aiter__(self) -> "LiveQueue":
        return self

    async def __anext__(self) -> LiveBlock:
        while not self._blocks:
            if self._closed:
                raise StopAsyncIteration
            self._news.clear()
            await self._news.wait()
        return self._blocks.popleft()


class LiveHub:
    """Fans the samples of running sweeps out to the subscribers of their campaign."""

    def __init__(self, rate: float, depth: int = 64) -> None:
        """`rate`: samples a second that a subscriber gets at most, Hz. `depth`: blocks kept for a slow one."""
        self._rate = rate
        self._depth = depth
        self._queues: dict[int, list[LiveQueue]] = {}
        self._closed = False

    def publish(self, campaign_id: int, number: int, block: SampleBlock) -> None:
        """Hand a block to every subscriber of the campaign; returns at once."""
        queues = self._queues.get(campaign_id, [])
        if queues and len(block.time):
            thinned = thin(campaign_id, number, block, self._rate)
            for queue in queues:
                queue.put(thinned)

    @contextmanager
    def subscribe(self, campaign_id: int) -> Generator[LiveQueue]:
        """``with hub.subscribe(id) as queue: async for block in queue: ...``; ends when the hub is closed."""
        queue = LiveQueue(self._depth)
        if self._closed:
            queue.close()
        self._queues.setdefault(campaign_id, []).append(queue)
        try:
            yield queue
        finally:
            self._queues[campaign_id].remove(queue)
            if not self._queues[campaign_id]:
                del self._queues[campaign_id]

    def close(self) -> None:
        """End every subscriber's iteration."""
        self._closed = True
        for queues in self._queues.values():
            for queue in queues:
                queue.close()


def thin(campaign_id: int, number: int, block: SampleBlock, rate: float) -> LiveBlock:
    """Means over as many consecutive samples as bring the block down to `rate`, Hz. For the eye, not for analysis."""
    count = len(block.time)
    step = float(np.median(np.diff(block.time))) if count > 1 else 1.0 / rate
    starts = np.arange(0, count, max(1, round(1.0 / (rate * step))))
    sizes = np.diff(np.append(starts, count))
    time, effort, velocity, position = (
        np.add.reduceat(column, starts) / sizes for column in (block.time, block.effort, block.velocity, block.position)
    )
    return LiveBlock(campaign_id, number, block.joint, time, effort, velocity, position)


class EventFeed:
    """Follows the outbox: what the store has, then what comes."""

    def __init__(self, store: Store, database: Database) -> None:
        """To be made in the event loop that follows it; `database` tells of writes."""
        self._store = store
        self._loop = asyncio.get_running_loop()
        self._waiting: set[asyncio.Event] = set()
        self._closed = False
        database.on_write(self._written)

    async def follow(self, after: int, campaign_id: int | None = None) -> AsyncGenerator[EventDocument]:
        """Events with an id above `after` (of one campaign and the machine, or all), in order, until closed.

        A database that does not answer is asked again: who follows loses time, and no event.
        """
        news = asyncio.Event()
        self._waiting.add(news)
        try:
            while not self._closed:
                news.clear()  # before reading: what is written from here on rings again
                try:
                    events = await asyncio.to_thread(self._store.events, after, campaign_id)
                except SQLAlchemyError as refused:
                    _log.warning("events_not_read", after=after, reason=refusal(refused))
                    with suppress(TimeoutError):
                        await asyncio.wait_for(news.wait(), RETRY)
                    continue
                for event in events:
                    yield event
                    after = event.id
                if not events:
                    await news.wait()
        finally:
            self._waiting.discard(news)

    def close(self) -> None:
        """End every follower."""
        self._closed = True
        self._ring()

    def _written(self) -> None:
        if not self._closed and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._ring)

    def _ring(self) -> None:
        for news in self._waiting:
            news.set()
