"""The machine: the drive port behind the lease and the latched stop. What moves asks `check_may_move` first."""

import asyncio
import time
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from functools import partial
from typing import ParamSpec, TypeVar

import structlog
from sqlalchemy.exc import SQLAlchemyError

from drivers.errors import CommunicationLost, DriveError
from drivers.ports import AxisIdentity, AxisState, AxisStatus, Capabilities, DrivePort, Fault
from service.errors import Conflict
from service.store.documents import StopDocument
from service.store.guards import LeaseLost, MachineLease, StopLatch

_log = structlog.get_logger(__name__)

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

NOT_STORED = 0  # id of a stop of which the database has taken no word


class Machine:
    """One drive port, its connection, who uses it and who stopped it."""

    def __init__(self, port: DrivePort, latch: StopLatch, latched: StopDocument | None) -> None:
        """`latched`: the stop that was in force when the service started."""
        self.port = port
        self._latch = latch
        self._latched = latched
        self._stops = 0  # under way
        self._latching = asyncio.Lock()  # what stands in the store and what is held here change in the same order
        self._lease_trouble = ""  # why this service may not be the owner of the machine any more
        self._lease_over = False  # and that does not change any more
        self._user: str | None = None
        self._disturbed = ""  # what stopped that user, or the last one
        self._identities: tuple[AxisIdentity, ...] = ()
        self._trouble = "not connected yet"
        self._connecting = asyncio.Lock()

    @property
    def joints(self) -> tuple[str, ...]:
        return self.port.joints

    @property
    def connected(self) -> bool:
        return not self._trouble

    @property
    def trouble(self) -> str:
        """Why it is not connected; empty if it is."""
        return self._trouble

    @property
    def identities(self) -> tuple[AxisIdentity, ...]:
        """What the drives said of themselves when they were connected last."""
        return self._identities

    @property
    def capabilities(self) -> Capabilities:
        """Conflict while not connected."""
        self._check_connected()
        return self.port.capabilities

    @property
    def latched(self) -> StopDocument | None:
        """The stop that holds the machine, or None. Its id is NOT_STORED until the database has taken it."""
        return self._latched

    async def connect(self) -> tuple[AxisIdentity, ...]:
        """Connect, also again after a loss; every axis is disabled afterwards.

        Conflict while a campaign runs, or if another service has taken the machine.
        """
        async with self._connecting:
            self._check_unused("connect")
            if self._lease_over:
                raise Conflict(f"connect: {self._lease_trouble}")
            self._trouble = "connecting"
            try:
                await self.port.close()
                self._identities = await self.port.connect()
            except DriveError as error:
                self._trouble = str(error)
                raise
            self._trouble = ""
            return self._identities

    async def reach(self) -> None:
        """Connect unless a drive answers: its cabinet may have been switched off and on while nobody asked.

        DriveError; Conflict while a campaign runs.
        """
        if self.connected:
            with suppress(CommunicationLost):
                await self.status()
        if not self.connected:
            await self.connect()

    def lost(self, why: str) -> None:
        """The connection went away; nothing moves until a person connects again."""
        self._trouble = why

    async def status(self) -> Mapping[str, AxisStatus]:
        """The state of every axis. Conflict while not connected."""
        self._check_connected()
        try:
            status = await self.port.status()
        except CommunicationLost as error:
            self.lost(str(error))
            raise
        if self._user is None and all(axis.state is AxisState.UNKNOWN for axis in status.values()):
            self.lost("no drive answers")
        return status

    async def faults(self) -> tuple[Fault, ...]:
        """Pending faults of all axes. Conflict while not connected."""
        self._check_connected()
        return await self.port.faults()

    async def acknowledge(self, joint: str) -> None:
        """Clear the fault of an axis after a person looked. Conflict while a campaign runs."""
        self._check_connected()
        self._check_unused("acknowledge")
        await self.port.acknowledge(joint)

    async def stop(self, by: str, why: str) -> StopDocument:
        """Stop every axis first, then latch: nothing moves until a person resets it. May be called at any time.

        It holds also where the database does not take it (SQLAlchemyError), but then not beyond a restart.
        """
        # before anything is awaited: who is about to move finds it
        self._latched = StopDocument(id=NOT_STORED, by=by, why=why, at=datetime.now(UTC), reset_by=None, reset_at=None)
        self._disturb()
        self._stops += 1
        try:
            await self.port.stop()
        finally:
            try:
                async with self._latching:
                    self._latched = latched = await _apart(self._latch.latch, by, why)
            finally:
                self._stops -= 1
        _log.warning("stop", by=by, why=why)
        return latched

    async def reset_stop(self, by: str) -> StopDocument:
        """A person looked and lets the machine move again; nothing moves by this.

        Conflict if it is not stopped, or while a stop is under way.
        """
        async with self._latching:
            if self._stops:
                raise Conflict(f"a stop is under way: {self._forbidden}")
            try:
                document = await _apart(self._latch.reset, by)
            except Conflict:
                if self._latched is None:
                    raise
                document = self._latched.model_copy(update={"reset_by": by, "reset_at": datetime.now(UTC)})
            if not self._stops:  # none came meanwhile
                self._latched = None
        _log.warning("stop_reset", by=by)
        return document

    @property
    def held(self) -> str:
        """Why nothing may move, though the drives answer, or what stopped its present or last user; "" if neither."""
        return self._forbidden or self._disturbed

    def check_may_move(self) -> None:
        """Conflict while stopped, without lease or not connected.

        For who uses the machine also if it was so meanwhile: a reset by somebody else lets nobody move on.
        """
        reason = self._forbidden if self._user is None else self.held
        if reason:
            raise Conflict(f"the machine may not move: {reason}")
        self._check_connected()

    @contextmanager
    def used_by(self, user: str) -> Generator[None]:
        """While the block runs, nobody else connects, acknowledges or moves; Conflict if somebody does already."""
        self._check_unused(user)
        self._user, self._disturbed = user, ""
        try:
            yield
        finally:
            self._user = None

    async def keep_lease(self, lease: MachineLease, lease_time: float) -> None:
        """Renew the lease until it is another's. While it cannot be renewed (database blocked), the machine stands.

        It also stands, until a restart, if this watch ends by an error that nobody thought of.
        """
        try:
            await self._keep_lease(lease, lease_time)
        except LeaseLost as error:
            _log.error("lease_lost")
            await self._let_go(f"{error}; restart this one")
        except Exception as error:
            _log.error("lease_watch_broke_off", exc_info=error)
            await self._let_go(f"nobody watches over the right to the machine any more: {error!r}; restart this one")
            raise

    async def _keep_lease(self, lease: MachineLease, lease_time: float) -> None:
        renewed = time.monotonic()
        while True:
            await asyncio.sleep(lease_time / 5)
            begun = time.monotonic()
            # one attempt at a time, however long it takes: threads that wait for the database must not pile up
            attempt = asyncio.create_task(_apart(lease.renew), name="renew lease")
            try:
                while not (await asyncio.wait([attempt], timeout=lease_time / 5))[0]:
                    await self._check_renewed(renewed, lease_time)
            finally:
                await asyncio.wait([attempt])
            try:
                attempt.result()
            except SQLAlchemyError as error:  # also a full pool, a broken file: it must not end the watch
                _log.warning("lease_not_renewed", reason=str(error))
                await self._check_renewed(renewed, lease_time)
            else:
                renewed = begun
                self._lease_trouble = ""

    async def _check_renewed(self, renewed: float, lease_time: float) -> None:
        if time.monotonic() - renewed > lease_time / 2 and not self._lease_trouble:
            reason = "the right to the machine could not be renewed: the database does not answer"
            _log.error("lease_not_renewed", reason=reason)
            await self._stop_quietly(reason)

    async def _let_go(self, why: str) -> None:
        """Stop and leave the bus for good: our heartbeat there would hide from the drives that their host is gone."""
        self._lease_over = True
        await self._stop_quietly(why)
        async with self._connecting:
            await self.port.close()
            self.lost(why)

    async def _stop_quietly(self, why: str) -> None:
        self._lease_trouble = why
        self._disturb()
        try:
            await self.port.stop()
        except DriveError as error:
            _log.error("stop_not_confirmed", reason=str(error))
            self.lost(str(error))

    @property
    def _forbidden(self) -> str:
        """Why nobody may move the machine now."""
        if self._latched is not None:
            return f"stopped by {self._latched.by}: {self._latched.why}"
        return self._lease_trouble

    def _disturb(self) -> None:
        """Its present user is to move it no more, also if it may be moved again before they look."""
        if self._user is not None:
            self._disturbed = self._forbidden

    def _check_connected(self) -> None:
        if self._trouble:
            raise Conflict(f"the machine is not connected: {self._trouble}")

    def _check_unused(self, what: str) -> None:
        if self._user is not None:
            raise Conflict(f"{what}: the machine is in use by {self._user}")


async def _apart(work: Callable[Arguments, Result], *args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
    """On a thread of its own: what keeps the machine safe waits for nothing that fills the threads which all share."""
    executor = ThreadPoolExecutor(1, thread_name_prefix="machine")
    result = asyncio.get_running_loop().run_in_executor(executor, partial(work, *args, **kwargs))
    executor.shutdown(wait=False)  # the thread ends with its one task
    return await result
