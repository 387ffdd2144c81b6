"""Live data for subscribers, in the service's event loop: samples of running sweeps, and events of the outbox.

The runner never waits for a subscriber: every queue is bounded and drops its oldest block.
"""

import asyncio
from collections import deque
from collections.abc import AsyncGenerator, Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import numpy as np
import structlog
from sqlalchemy.exc import SQLAlchemyError

from drivers.ports import SampleBlock
from service.model import Array
from service.store.database import Database, refusal
from service.store.documents import EventDocument
from service.store.store import Store

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class LiveBlock:
    """Decimated samples of one block: arrays (n,), s and SI on the joint side. Equal only to itself."""

    campaign_id: int
    number: int
    joint: str
    time: Array
    effort: Array
    velocity: Array
    position: Array


class LiveQueue:
    """The blocks of one subscriber: ``async for block in queue``. `dropped`: number of blocks lost by slow reading."""

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
        """The iteration ends after the blocks in the queue."""
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
    """Distributes the samples of running sweeps to the subscribers of their campaign."""

    def __init__(self, rate: float, depth: int = 64) -> None:
        """`rate`: maximum sample rate for a subscriber, Hz. `depth`: number of blocks kept for a slow subscriber."""
        self._rate = rate
        self._depth = depth
        self._queues: dict[int, list[LiveQueue]] = {}
        self._closed = False
        self._dropped = 0  # by subscribers that have left

    @property
    def viewers(self) -> int:
        """Number of present subscribers."""
        return sum(len(queues) for queues in self._queues.values())

    @property
    def dropped(self) -> int:
        """Number of blocks lost by slow reading, of all subscribers since the start."""
        return self._dropped + sum(queue.dropped for queues in self._queues.values() for queue in queues)

    def publish(self, campaign_id: int, number: int, block: SampleBlock) -> None:
        """Put a block into the queue of every subscriber of the campaign; returns immediately."""
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
            self._dropped += queue.dropped
            if not self._queues[campaign_id]:
                del self._queues[campaign_id]

    def close(self) -> None:
        """End every subscriber's iteration."""
        self._closed = True
        for queues in self._queues.values():
            for queue in queues:
                queue.close()


def thin(campaign_id: int, number: int, block: SampleBlock, rate: float) -> LiveBlock:
    """Means of consecutive samples, so many that the rate is at most `rate`, Hz. For display, not for analysis."""
    count = len(block.time)
    step = float(np.median(np.diff(block.time))) if count > 1 else 1.0 / rate
    starts = np.arange(0, count, max(1, round(1.0 / (rate * step))))
    sizes = np.diff(np.append(starts, count))
    time, effort, velocity, position = (
        np.add.reduceat(column, starts) / sizes for column in (block.time, block.effort, block.velocity, block.position)
    )
    return LiveBlock(campaign_id, number, block.joint, time, effort, velocity, position)


class EventFeed:
    """Follows the outbox: first the stored events, then the new ones."""

    retry = 2.0  # s until the next attempt after an error of the database

    def __init__(self, store: Store, database: Database) -> None:
        """Create it in the event loop that follows it. `database` reports its writes."""
        self._store = store
        self._loop = asyncio.get_running_loop()
        self._waiting: list[asyncio.Event] = []  # in the order of their coming, in which they are woken
        self._closed = False
        database.on_write(self._written)

    async def follow(self, after: int, campaign_id: int | None = None) -> AsyncGenerator[EventDocument]:
        """Events with an id above `after` (of one campaign and the machine, or all), in order, until closed.

        If the database does not answer, the query is repeated: a follower gets events late, but loses none.
        """
        news = asyncio.Event()
        self._waiting.append(news)
        try:
            while not self._closed:
                news.clear()  # before reading: a later write sets it again
                try:
                    events = await asyncio.to_thread(self._store.events, after, campaign_id)
                except SQLAlchemyError as refused:
                    _log.warning("events_not_read", after=after, reason=refusal(refused))
                    with suppress(TimeoutError):
                        async with asyncio.timeout(self.retry):
                            await news.wait()
                    continue
                for event in events:
                    yield event
                    after = event.id
                if not events:
                    await news.wait()
        finally:
            self._waiting.remove(news)

    async def watch(self) -> None:
        """Until cancelled: followers also get the events of other services in the same database, within 1 s."""
        while True:
            await asyncio.sleep(1.0)
            if self._waiting and not self._closed:
                self._ring()

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
