"""The stops that hold the machine: here at once, in the database as soon as it takes them. No stop waits for it."""

import asyncio
import itertools
import secrets
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import ParamSpec, TypeVar

import structlog
from sqlalchemy.exc import SQLAlchemyError

from service.errors import Conflict, NotFound, NotNow
from service.store.database import refusal
from service.store.documents import StopDocument
from service.store.guards import StopLatch

_log = structlog.get_logger(__name__)

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

AGAIN = 1.0  # s until the database is asked again to take a stop
_MOST_NAMES = 1000
_NAMES = 2**30


@dataclass(slots=True, eq=False)
class Hold:
    """A stop that holds the machine. The id of its document is negative until the database has taken it."""

    document: StopDocument
    press: str  # of a button whose word comes by two ways
    under_way: int = 0  # how many wait for the drives to confirm it


class Holds:
    """`take` is for any thread, all else for the event loop."""

    def __init__(self, latch: StopLatch, latched: Sequence[StopDocument]) -> None:
        """`latched`: the stops in force when the service started."""
        self._latch = latch
        self._holds = [Hold(stop, "") for stop in latched]  # oldest first
        # not from -1: who releases a stop of the service before this one must not name one of ours
        self._names = itertools.count(-1 - secrets.randbelow(_NAMES), -1)
        self._ids: dict[int, int] = {}  # by the negative number that was told first; newest last
        self._writing = asyncio.Lock()  # what stands in the store and what is held here change in the same order
        self._noting: asyncio.Task[None] | None = None
        self._ending = asyncio.Event()

    @property
    def documents(self) -> tuple[StopDocument, ...]:
        """Of every stop that holds the machine, oldest first."""
        return tuple(hold.document for hold in tuple(self._holds))

    def take(self, by: str, why: str, press: str) -> Hold:
        """A new one, or that of the same press."""
        hold = next((each for each in tuple(self._holds) if press and each.press == press), None)
        if hold is None:
            at = datetime.now(UTC)
            document = StopDocument(id=next(self._names), by=by, why=why, at=at, reset_by=None, reset_at=None)
            hold = Hold(document, press)
            self._holds.append(hold)
        hold.under_way += 1
        return hold

    def note(self) -> None:
        """Have the database take what it has not; waits for nothing."""
        if self._noting is None or self._noting.done():
            self._noting = asyncio.create_task(self._note(), name="note stops")

    async def noted(self) -> None:
        """Waits until the database has taken every stop."""
        if self._noting is not None:
            await asyncio.wait([self._noting])

    async def close(self) -> None:
        """What the database refuses once more is in the log alone."""
        self._ending.set()
        await self.noted()

    async def reset(self, by: str, stops: Sequence[int]) -> tuple[StopDocument, ...]:
        """Release these, by their ids or the negative ones that they had. NotFound; Conflict while one is under way.

        NotNow where the database does not take it: then they hold on, here and there.
        """
        async with self._writing:
            ids = [self._ids.get(number, number) for number in stops]
            named = {hold.document.id: hold for hold in tuple(self._holds) if hold.document.id in ids}
            for number, hold in named.items():
                if hold.under_way:
                    raise Conflict(f"stop {number} is under way: {hold.document.by}: {hold.document.why}")
            unstored = {number: hold.document for number, hold in named.items() if number < 0}
            for number in ids:
                if number < 0 and number not in unstored:
                    raise NotFound(f"stop {number}")
            try:
                stored = await apart(self._latch.reset, by, [number for number in ids if number >= 0])
            except SQLAlchemyError as error:
                raise NotNow(
                    f"nothing is released, because the database does not take it ({type(error).__name__}): the machine "
                    "stays held; look for what locks it or fills its disk, and release again"
                ) from error
            for hold in named.values():
                self._holds.remove(hold)
        done = {"reset_by": by, "reset_at": datetime.now(UTC)}
        return (*stored, *(document.model_copy(update=done) for document in unstored.values()))

    async def _note(self) -> None:
        while (hold := next((each for each in tuple(self._holds) if each.document.id < 0), None)) is not None:
            if await self._noted(hold):
                continue
            if self._ending.is_set():
                _log.error("stop_not_noted", by=hold.document.by, why=hold.document.why, until="the service ends")
                return
            with suppress(TimeoutError):
                await asyncio.wait_for(self._ending.wait(), AGAIN)

    async def _noted(self, hold: Hold) -> bool:
        async with self._writing:
            if hold not in self._holds:  # released meanwhile
                return True
            told = hold.document
            try:
                hold.document = await apart(self._latch.latch, told.by, told.why, told.at)
            except SQLAlchemyError as error:
                _log.error("stop_not_noted_yet", by=told.by, why=told.why, reason=refusal(error))
                return False
            self._ids[told.id] = hold.document.id
            if len(self._ids) > _MOST_NAMES:
                del self._ids[next(iter(self._ids))]
            return True


async def apart(work: Callable[Arguments, Result], *args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
    """On a thread of its own: what keeps the machine safe waits for nothing that fills the threads which all share."""
    executor = ThreadPoolExecutor(1, thread_name_prefix="machine")
    result = asyncio.get_running_loop().run_in_executor(executor, partial(work, *args, **kwargs))
    executor.shutdown(wait=False)  # the thread ends with its one task
    return await result
