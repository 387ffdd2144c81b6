"""The latched stops: in memory immediately, in the database as soon as possible. No stop waits for the database."""

import asyncio
import itertools
import secrets
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import ParamSpec, TypeVar

import structlog
from sqlalchemy.exc import SQLAlchemyError

from drivers.errors import Cause
from service.model.errors import Conflict, NotFound, NotNow
from service.store.access.credentials import masked
from service.store.database import refusal
from service.store.documents import StopDocument
from service.store.guards import StopLatch

_log = structlog.get_logger(__name__)

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

AGAIN = 1.0  # s until storing a stop is tried again
MERGED = 2.0  # s after a stop in which a repetition from the same source is the same stop
MOST = 100  # stops in force, after which another one repeats the newest of them
_MOST_NAMES = 1000
_NAMES = 2**30


@dataclass(slots=True, eq=False)
class Hold:
    """A stop that holds the machine. The id of its document is negative until the database has stored it, and again
    after a repetition: who releases names what was seen, and that was less.
    """

    document: StopDocument
    press: str  # id of a button press that is received by two ways
    names: set[int]  # its ids since its last repetition
    row: int | None = None  # its id in the database
    source: str = ""
    last: float = 0.0  # time of its last repetition, s on the monotonic clock
    repeated: bool = False
    reported: bool = False  # to the audit, by the port of the stop process
    under_way: int = 0  # number of callers that wait for confirmation by the drives


class LatchedStops:
    """`take` may be called from any thread, everything else from the event loop."""

    def __init__(self, latch: StopLatch, latched: Sequence[StopDocument]) -> None:
        """`latched`: the stops in force at the start of the service."""
        self._latch = latch
        self._holds = [Hold(stop, "", {stop.id}, stop.id) for stop in latched]  # oldest first
        # not from -1: an id of the previous run of the service must not match a new stop
        self._names = itertools.count(-1 - secrets.randbelow(_NAMES), -1)
        self._ids: dict[int, int] = {}  # in the database, by each negative id that was reported; newest last
        self._taking = threading.Lock()
        self._writing = asyncio.Lock()  # store and memory change in the same order
        self._noting: asyncio.Task[None] | None = None
        self._ending = asyncio.Event()

    @property
    def documents(self) -> tuple[StopDocument, ...]:
        """Documents of every stop that holds the machine, oldest first."""
        return tuple(hold.document for hold in tuple(self._holds))

    def take(self, by: str, why: str, press: str, source: str = "", cause: Cause | None = None) -> Hold:
        """A new stop, or the existing one of the same press, or of the same `source` a moment ago ("": of none).

        It is displayed and stored: keys are masked.
        """
        now = time.monotonic()
        with self._taking:
            holds = tuple(self._holds)
            hold = next((each for each in holds if press and each.press == press), None)
            same = hold is not None
            if hold is None and source:
                hold = next((each for each in holds if each.source == source and now - each.last < MERGED), None)
            if hold is None and len(holds) >= MOST:
                hold = holds[-1]
            if hold is None:
                at = datetime.now(UTC)
                by, why = masked(by), masked(why)
                document = StopDocument(
                    id=next(self._names), by=by, why=why, cause=cause, at=at, reset_by=None, reset_at=None
                )
                hold = Hold(document, press, {document.id}, source=source or str(document.id))
                self._holds.append(hold)
            else:
                hold.repeated = True
                if not same:
                    self._rename(hold)
            hold.last = now
            hold.under_way += 1
            return hold

    def note(self) -> None:
        """Store pending stops in the database in the background; does not wait."""
        if self._noting is None or self._noting.done():
            self._noting = asyncio.create_task(self._note(), name="note stops")

    async def noted(self) -> None:
        """Wait until the database has stored every stop."""
        if self._noting is not None:
            await asyncio.wait([self._noting])

    async def close(self) -> None:
        """Try once more to store pending stops; those that fail are only in the log."""
        self._ending.set()
        await self.noted()

    async def reset(self, by: str, stops: Sequence[int]) -> tuple[StopDocument, ...]:
        """Release these stops, by their ids or their earlier negative ids. NotFound; Conflict while one is in progress.

        NotNow if the database cannot store it: then they remain in force.
        """
        async with self._writing:
            holds = tuple(self._holds)
            seen = {name: hold for hold in holds for name in hold.names}
            named = {number: seen[number] for number in stops if number in seen}
            for number, hold in named.items():
                if hold.under_way:
                    raise Conflict(f"stop {number} is not finished yet: {hold.document.by}: {hold.document.why}")
            rows = {number: self._ids.get(number, number) for number in stops if number not in named}
            for number, row in rows.items():
                if any(hold.row == row for hold in holds):
                    raise Conflict(
                        f"stop {number} was repeated since it was seen: look at the machine, then release again"
                    )
                if row < 0:
                    raise NotFound(f"stop {number}")
            try:
                for number, hold in named.items():
                    if hold.row is None:  # a stop that is not stored would end no approval
                        await self._store(hold)
                    rows[number] = hold.row or number
                released = await apart(self._latch.reset, by, [rows[number] for number in stops])
            except SQLAlchemyError as error:
                raise NotNow(
                    f"not released, because the database cannot be written ({type(error).__name__}): "
                    "the machine stays stopped. Check locks and disk of the database, then release "
                    "again"
                ) from error
            with self._taking:
                for number, hold in named.items():
                    if number not in hold.names:  # repeated while the database released it: stored again
                        hold.row = None
                    elif hold in self._holds:
                        self._holds.remove(hold)
        self.note()
        return released

    async def _note(self) -> None:
        while (hold := next((each for each in tuple(self._holds) if each.row is None), None)) is not None:
            if await self._noted(hold):
                continue
            if self._ending.is_set():
                _log.error("stop_not_noted", by=hold.document.by, why=hold.document.why, until="the service ends")
                return
            with suppress(TimeoutError):
                await asyncio.wait_for(self._ending.wait(), AGAIN)

    async def _noted(self, hold: Hold) -> bool:
        async with self._writing:
            document = hold.document
            if hold not in self._holds or hold.row is not None:  # released or stored meanwhile
                return True
            try:
                await self._store(hold)
            except SQLAlchemyError as error:
                _log.error("stop_not_noted_yet", by=document.by, why=document.why, reason=refusal(error))
                return False
            return True

    async def _store(self, hold: Hold) -> None:
        document = hold.document
        stored = await apart(self._latch.latch, document.by, document.why, document.at, document.cause)
        with self._taking:
            hold.row = stored.id
            self._remember(document.id, stored.id)
            if hold.document is document:
                hold.document = stored
                hold.names.add(stored.id)
            else:  # repeated meanwhile
                self._remember(hold.document.id, stored.id)

    def _rename(self, hold: Hold) -> None:
        """Called with the lock held."""
        hold.document = hold.document.model_copy(update={"id": next(self._names)})
        hold.names = {hold.document.id}
        if hold.row is not None:
            self._remember(hold.document.id, hold.row)

    def _remember(self, name: int, row: int) -> None:
        """Called with the lock held."""
        self._ids[name] = row
        if len(self._ids) > _MOST_NAMES:
            del self._ids[next(iter(self._ids))]


async def apart(work: Callable[Arguments, Result], *args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
    """Run `work` on a separate thread: safety functions must not wait for a full shared thread pool."""
    executor = ThreadPoolExecutor(1, thread_name_prefix="machine")
    result = asyncio.get_running_loop().run_in_executor(executor, partial(work, *args, **kwargs))
    executor.shutdown(wait=False)  # the thread ends with its only task
    return await result
