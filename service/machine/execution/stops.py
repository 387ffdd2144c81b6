"""The stops of the machine: sent to the drives, latched in memory at once, in the database as soon as possible.

No stop waits for the database. Few stop sequences run at a time, and a stop never shares one that began before it.
While the machine's lease cannot be renewed, the machine stands as well: another service may take it (`renew`).
"""

import asyncio
import itertools
import secrets
import threading
import time
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import ParamSpec, Protocol, TypeVar

import structlog
from sqlalchemy.exc import SQLAlchemyError

from drivers.errors import Cause, CauseCode, DriveError, StopNotConfirmed
from service import Conflict, NotFound, NotNow
from service.process.tasks import Background
from service.store.access import masked
from service.store.database import refusal
from service.store.documents import StopDocument
from service.store.lease_and_latch import MachineLease, StopLatch

_log = structlog.get_logger(__name__)

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


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
    renewed: bool = False  # repeated since the database stored it, which does not know that yet
    reported: bool = False  # to the audit, by the port of the stop process
    under_way: int = 0  # number of callers that wait for confirmation by the drives


class LatchedStops:
    """`latch` may be called from any thread, everything else from the event loop."""

    again = 1.0  # s until storing a stop is tried again
    merged = 2.0  # s after a stop in which a repetition from the same source is the same stop
    most = 100  # stops in force, after which another one repeats the newest of them

    def __init__(self, latch: StopLatch, latched: Sequence[StopDocument]) -> None:
        """`latched`: the stops in force at the start of the service."""
        self._latch = latch
        self._holds = [Hold(stop, "", {stop.id}, stop.id) for stop in latched]  # oldest first
        # not from -1: an id of the previous run of the service must not match a new stop
        self._names = itertools.count(-1 - secrets.randbelow(2**30), -1)
        self._ids: dict[int, int] = {}  # in the database, by each negative id that was reported; newest last
        self._taking = threading.Lock()
        self._writing = asyncio.Lock()  # store and memory change in the same order
        self._noting: asyncio.Task[None] | None = None
        self._ending = asyncio.Event()

    @property
    def documents(self) -> tuple[StopDocument, ...]:
        """Documents of every stop that holds the machine, oldest first."""
        return tuple(hold.document for hold in tuple(self._holds))

    def latch(self, by: str, why: str, press: str, source: str = "", cause: Cause | None = None) -> Hold:
        """A new stop, or the existing one of the same press, or of the same `source` a moment ago ("": of none).

        It is displayed and stored: keys are masked.
        """
        now = time.monotonic()
        with self._taking:
            holds = tuple(self._holds)
            hold = next((each for each in holds if press and each.press == press), None)
            same = hold is not None
            if hold is None and source:
                hold = next((each for each in holds if each.source == source and now - each.last < self.merged), None)
            if hold is None and len(holds) >= self.most:
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
                    await self._settle(hold)  # a stop that is not stored would end no approval
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
        while (
            hold := next((each for each in tuple(self._holds) if each.row is None or each.renewed), None)
        ) is not None:
            if await self._noted(hold):
                continue
            if self._ending.is_set():
                _log.error("stop_not_noted", by=hold.document.by, why=hold.document.why, until="the service ends")
                return
            with suppress(TimeoutError):
                async with asyncio.timeout(self.again):
                    await self._ending.wait()

    async def _noted(self, hold: Hold) -> bool:
        async with self._writing:
            document = hold.document
            if hold not in self._holds:  # released meanwhile
                return True
            try:
                await self._settle(hold)
            except SQLAlchemyError as error:
                _log.error("stop_not_noted_yet", by=document.by, why=document.why, reason=refusal(error))
                return False
            return True

    async def _settle(self, hold: Hold) -> None:
        """The database knows the stop and its repetitions: approvals that are older have ended."""
        if hold.row is None:
            await self._store(hold)
        elif hold.renewed:
            hold.renewed = False
            try:
                await apart(self._latch.repeat, hold.row)
            except SQLAlchemyError:
                hold.renewed = True
                raise

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
                hold.renewed = True
                self._remember(hold.document.id, stored.id)

    def _rename(self, hold: Hold) -> None:
        """Called with the lock held."""
        hold.document = hold.document.model_copy(update={"id": next(self._names)})
        hold.names = {hold.document.id}
        if hold.row is not None:
            hold.renewed = True
            self._remember(hold.document.id, hold.row)

    def _remember(self, name: int, row: int) -> None:
        """Called with the lock held."""
        self._ids[name] = row
        if len(self._ids) > 1000:  # the latest ones are enough
            del self._ids[next(iter(self._ids))]


async def apart(work: Callable[Arguments, Result], *args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
    """Run `work` on a separate thread: safety functions must not wait for a full shared thread pool."""
    executor = ThreadPoolExecutor(1, thread_name_prefix="machine")
    result = asyncio.get_running_loop().run_in_executor(executor, partial(work, *args, **kwargs))
    executor.shutdown(wait=False)  # the thread ends with its only task
    return await result


class Stops(Protocol):
    """Of `drivers.ports.DrivePort` what stops, and nothing that moves."""

    @property
    def joints(self) -> tuple[str, ...]: ...

    def halt(self) -> None: ...

    async def stop(self) -> tuple[str, ...]: ...


class StopSequences:
    """The calls of `DrivePort.halt` and `stop` of one machine."""

    at_once = 2  # a second one does not wait for the first, whose drives may be silent
    halted = 0.02  # s after a stop in which its repetition sends nothing: a flood must not fill the bus

    def __init__(self, port: Stops) -> None:
        self._port = port
        self._running: set[asyncio.Task[tuple[str, ...]]] = set()
        self._next: asyncio.Task[tuple[str, ...]] | None = None  # not begun yet
        self._halted = float("-inf")  # time of the last stop that was sent, s on the monotonic clock
        self._background = Background()

    def halt(self, hold: Hold) -> None:
        """Send the stop to every axis, unless a repeated one was sent this moment. From any thread."""
        now = time.monotonic()
        if not hold.repeated or now - self._halted > self.halted:
            self._port.halt()
            self._halted = now

    async def within(self, hold: Hold, confirming: Coroutine[object, object, Result], limit: float) -> Result:
        """The result of `confirming`, or StopNotConfirmed after `limit` s; then it goes on, and its error is logged."""
        task = asyncio.create_task(confirming, name="confirm a stop")
        await asyncio.wait([task], timeout=limit)
        if task.done():
            return task.result()
        self._background.begin("confirm a stop", self.logged(hold, task))
        raise StopNotConfirmed((), dict.fromkeys(self._port.joints, f"did not confirm it within {limit:g} s"))

    async def logged(self, hold: Hold, confirming: Awaitable[object]) -> None:
        """For a stop whose caller does not wait for its outcome."""
        try:
            await confirming
        except DriveError as error:
            _log.error("stop_not_confirmed", by=hold.document.by, reason=str(error))

    async def confirmed(self) -> tuple[str, ...]:
        """The result of a sequence that begins after this call. Errors as `DrivePort.stop`. Safe to cancel."""
        if self._next is None:
            self._next = asyncio.create_task(self._begin(), name="stop sequence")
            self._next.add_done_callback(_retrieved)
        return await asyncio.shield(self._next)

    async def close(self) -> None:
        """Wait for the ends of all of them."""
        while tasks := [*self._running, *(() if self._next is None else (self._next,))]:
            await asyncio.wait(tasks)
        await self._background.settle()

    async def _begin(self) -> tuple[str, ...]:
        while len(self._running) >= self.at_once:
            await asyncio.wait(self._running, return_when=asyncio.FIRST_COMPLETED)
        task, self._next = self._next, None
        if task is not None:
            self._running.add(task)
            task.add_done_callback(self._running.discard)
        return await self._port.stop()


def _retrieved(task: "asyncio.Task[tuple[str, ...]]") -> None:
    """Its error is for those who wait; they may have been cancelled."""
    with suppress(asyncio.CancelledError, DriveError):
        task.result()


async def renew(
    lease: MachineLease, lease_time: float, renewed: Callable[[], None], late: Callable[[Cause], Awaitable[None]]
) -> None:
    """Renew it until another service has it (LeaseLost). `renewed` is called after each success.

    `late` gets the cause once, when half of the lease time, s, has passed without a renewal.
    """
    last, delayed, told = time.monotonic(), 0.0, False  # delayed: s since then by which this computer was delayed

    async def check() -> None:
        """Whatever the cause, `late` is called; `delayed` distinguishes the cause."""
        nonlocal told
        passed = _passed(last)
        if passed > lease_time / 2 and not told:
            told = True
            why = (
                f"this computer was delayed by {delayed:.1f} s"
                if delayed > passed / 2
                else "the database does not answer"
            )
            reason = f"the machine's lease could not be renewed: {why}"
            _log.error("lease_not_renewed", reason=reason)
            await late(Cause(CauseCode.LEASE_NOT_RENEWED, detail=reason))

    while True:
        delayed += await _wait(lease_time / 5)
        begun = time.monotonic()
        # one attempt at a time, however long it takes: waiting threads must not accumulate
        attempt = asyncio.create_task(apart(lease.renew), name="renew lease")
        try:
            while True:
                delayed += await _wait(lease_time / 5, attempt)
                if attempt.done():
                    break
                await check()
        finally:
            await asyncio.wait([attempt])
        try:
            attempt.result()
        except SQLAlchemyError as error:  # also a full pool or a broken file: it must not end this task
            _log.warning("lease_not_renewed", reason=refusal(error))
            await check()
        else:
            last, delayed, told = begun, 0.0, False
            renewed()


def _passed(since: float) -> float:
    """s since a time of the monotonic clock."""
    return time.monotonic() - since


async def _wait(within: float, work: "asyncio.Task[None] | None" = None) -> float:
    """Wait `within` s, or until `work` is done; returns by how many s this computer was delayed."""
    due = time.monotonic() + within
    if work is None:
        await asyncio.sleep(within)
    else:
        await asyncio.wait([work], timeout=within)
    return max(0.0, time.monotonic() - due)
