"""The machine: the drive port behind the lease and the latched stop. Only `motion` moves it.

Stops also come from outside the event loop: from the stop process or from the drivers (the host was suspended, another
host is on the bus, an axis was enabled or disabled by another party). Then the machine is held immediately; the loop
confirms and latches the stop later (`listening`, `watching`).
"""

import asyncio
import threading
import time
from collections.abc import AsyncGenerator, Callable, Generator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import replace
from functools import partial

import structlog

from drivers.errors import Cause, CauseCode, CommunicationLost, DriveError, StopNotConfirmed
from drivers.ports import (
    AxisIdentity,
    AxisState,
    AxisStatus,
    BusTraffic,
    Capabilities,
    ChannelTiming,
    DrivePort,
    Fault,
    ReportsTraffic,
    SetPointTiming,
)
from service import Conflict
from service.machine.execution.energising import Epochs, Intention
from service.machine.execution.motion import Bounds, MotionAccess
from service.machine.execution.statement import Condition, Reports, Statement
from service.machine.execution.stops import Hold, LatchedStops, StopSequences, renew
from service.machine.stop_process.handle import StopProcess
from service.process.tasks import Background, run_to_end
from service.store.documents import StopDocument
from service.store.lease_and_latch import LeaseLost, MachineLease, StopLatch

_log = structlog.get_logger(__name__)


class Machine:
    """One drive port, its connection, its present user and its stops."""

    def __init__(
        self,
        port: DrivePort,
        latch: StopLatch,
        latched: Sequence[StopDocument],
        order_stop: Callable[[], None] = lambda: None,
        tell: Callable[[str, Cause], None] = lambda way, cause: None,
    ) -> None:
        """`latched`: the stops in force at the start of the service. `order_stop` makes the stop process send as well.

        `tell` is called with source and cause of each stop that is not latched; it does not wait.
        """
        self._port = port
        self.epochs = Epochs()
        self._holds = LatchedStops(latch, latched)
        self._order_stop, self._tell = order_stop, tell
        self._ending: Cause | None = None  # the service ends: no motion until it is started again
        self._lease_trouble: Cause | None = None  # why this service may have lost the machine
        self._lease_over = False  # permanently
        self._user: str | None = None
        self._intention: Intention | None = None  # of the present or last user
        self._identities: tuple[AxisIdentity, ...] = ()
        self._trouble = "not connected yet"
        self._trouble_cause: Cause | None = None
        self._reports = Reports(port.joints)
        self._sequences = StopSequences(port)
        self._background = Background()
        self._answered: asyncio.Event | None = None  # of the present question to the drives
        self._connecting = asyncio.Lock()
        self._asking = asyncio.Lock()
        self._recent: tuple[float, Mapping[str, AxisStatus]] | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        return self._port.joints

    @property
    def connected(self) -> bool:
        return not self._trouble

    @property
    def trouble(self) -> str:
        """Why it is not connected; empty if it is."""
        return self._trouble

    @property
    def identities(self) -> tuple[AxisIdentity, ...]:
        """Identities reported by the drives at the last connect."""
        return self._identities

    @property
    def capabilities(self) -> Capabilities:
        """Raises Conflict while not connected."""
        self._check_connected()
        return self._port.capabilities

    @property
    def channel_timing(self) -> Mapping[str, ChannelTiming]:
        """Delays of the channels by the drives' filters, by joint."""
        return self._port.channel_timing

    @property
    def set_point_timing(self) -> SetPointTiming | None:
        """Punctuality of the set-points of the last streamed sweep; None after any other."""
        return self._port.set_point_timing

    @property
    def bus_traffic(self) -> BusTraffic | None:
        """Frames on the bus so far; None if the adapter does not count them."""
        return self._port.bus_traffic if isinstance(self._port, ReportsTraffic) else None

    def watch(self, tell: Callable[[Cause], None] | None) -> None:
        """Set the function that receives the findings of the host watch; None: no function."""
        self._port.watch(tell)

    @property
    def latched(self) -> StopDocument | None:
        """The oldest stop that holds the machine, or None."""
        return next(iter(self._holds.documents), None)

    @property
    def stops(self) -> tuple[StopDocument, ...]:
        """Every stop that holds the machine, oldest first. A stop not yet stored in the database has a negative id."""
        return self._holds.documents

    async def connect(self) -> tuple[AxisIdentity, ...]:
        """Connect, also after a loss; every axis is disabled afterwards.

        Raises Conflict while a campaign runs, or if another service has taken the machine.
        """
        async with self._connecting:
            self._check_unused("connect")
            if self._lease_over:
                raise Conflict(f"connect: {self._lease_trouble}")
            self.lost("connecting")
            try:
                await self._port.close()
                self._identities = await self._port.connect()
            except DriveError as error:
                self.lost(str(error), error.cause)
                raise
            self._trouble, self._trouble_cause, self._recent = "", None, None
            self._reports.connected()
            return self._identities

    async def reach(self) -> None:
        """Connect unless a drive answers: the cabinet may have been switched off and on meanwhile.

        Raises DriveError; Conflict while a campaign runs.
        """
        if self.connected:
            with suppress(CommunicationLost):
                await self.status()
        if not self.connected:
            await self.connect()

    def lost(self, why: str, cause: Cause | None = None) -> None:
        """The connection was lost; no motion until a person connects again."""
        self._trouble, self._trouble_cause, self._recent = why, cause, None
        self._reports.lost(f"not connected: {why}")

    @property
    def statement(self) -> Statement:
        """What is known of the state of the machine now; asks no drive. From any thread."""
        return self._reports.statement

    @property
    def answers(self) -> bool:
        """Whether it is connected and every drive answers."""
        return not self.silence

    @property
    def silence(self) -> str:
        """Why it is not connected or a drive does not answer; "" if all answer."""
        statement = self.statement
        return self._trouble or (statement.reason if statement.state is Condition.UNKNOWN else "")

    @property
    def silence_cause(self) -> Cause | None:
        """The cause of `silence`, if an error or a silent drive is the cause."""
        if self._trouble or not self.silence:
            return self._trouble_cause
        silent = [joint for joint, axis in self.statement.axes.items() if axis.state is Condition.UNKNOWN]
        return Cause(CauseCode.COMMUNICATION_LOST, silent[0] if len(silent) == 1 else "", detail=self.silence)

    async def ask(self) -> Statement:
        """The statement when the drives have answered, or after 0.5 s; one question for all callers. Never raises."""
        if self.connected:
            if self._answered is None:
                self._answered = asyncio.Event()
                self._background.begin("ask the drives", self._refresh(self._answered))
            with suppress(TimeoutError):
                async with asyncio.timeout(0.5):
                    await self._answered.wait()
        return self.statement

    async def _refresh(self, answered: asyncio.Event) -> None:
        try:
            with suppress(DriveError, Conflict):  # the statement tells it
                await self.recent_status()
        finally:
            self._answered = None
            answered.set()

    async def status(self) -> Mapping[str, AxisStatus]:
        """The state of every axis. Raises Conflict while not connected."""
        self._check_connected()
        asked = time.monotonic()
        try:
            status = await self._port.status()
        except CommunicationLost as error:
            self.lost(str(error), error.cause)
            raise
        self._reports.note(status, asked)
        if self._user is None and all(axis.state is AxisState.UNKNOWN for axis in status.values()):
            self.lost("no drive answers", Cause(CauseCode.COMMUNICATION_LOST, detail="no drive answers"))
        return status

    async def recent_status(self) -> Mapping[str, AxisStatus]:
        """As `status`, but up to 0.25 s old: the drives are read once in that time for any number of callers."""
        async with self._asking:
            if self._recent is None or time.monotonic() - self._recent[0] > 0.25:
                status = await self.status()
                self._recent = time.monotonic(), status
            return self._recent[1]

    async def faults(self) -> tuple[Fault, ...]:
        """Pending faults of all axes. Raises Conflict while not connected."""
        self._check_connected()
        return await self._port.faults()

    async def acknowledge(self, joint: str) -> None:
        """Clear the fault of an axis after a person checked it. Raises Conflict while a campaign runs."""
        self._check_connected()
        self._check_unused("acknowledge")
        await self._port.acknowledge(joint)
        self._recent = None

    async def stop(self, by: str, why: str, press: str = "", source: str = "", within: float = 1.0) -> StopDocument:
        """Stop every axis first, then latch: no motion until a person releases it. May be called at any time.

        StopNotConfirmed after at most `within` s names the axes that did not confirm standstill; the stop sequence goes
        on, and its outcome is logged. The machine is latched in any case. The database stores it meanwhile or later
        (`noted`); a stop that is not stored does not survive a restart.
        """
        self._order_stop()
        hold = self.latch(by, why, press, source)
        return await self._sequences.within(hold, self.confirm(hold), within)

    def latch(self, by: str, why: str, press: str = "", source: str = "", cause: Cause | None = None) -> Hold:
        """Block motion and send the stop to every axis; `confirm` must follow. From any thread.

        A repetition by the same press, or from the same `source` a moment ago, is the same stop. It begins an epoch all
        the same: a command may have been given since the first, and the person who presses again wants it to end.
        """
        hold = self._holds.latch(by, why, press, source, cause)  # before it is sent: a motion about to start finds it
        self.epochs.begin(_stopped(hold.document))
        self._sequences.halt(hold)
        return hold

    async def confirm(self, hold: Hold, presses: int = 1) -> StopDocument:
        """Run the stop sequence to confirmed standstill, while the database stores the stop. Errors as `stop`.

        `presses`: number of calls of `latch` that it is for.
        """
        self._holds.note()
        try:
            confirmed = await self._sequences.confirmed()
        finally:
            hold.under_way -= presses
            self._recent = None
        _log.warning("stop", stop=hold.document.id, by=hold.document.by, why=hold.document.why)
        reason = f"not connected: {self._trouble or 'the connection was closed'}"
        left = {joint: reason for joint in self.joints if joint not in confirmed}
        if left:
            raise StopNotConfirmed(confirmed, left)
        return hold.document

    async def confirm_logged(self, hold: Hold, presses: int = 1) -> None:
        """As `confirm`, for a stop whose caller does not wait: its errors are logged."""
        await self._sequences.logged(hold, self.confirm(hold, presses))

    def end(self, why: str) -> None:
        """The service ends: every axis is stopped, and motion is blocked. A second call reports nothing."""
        first, ending = self._ending is None, Cause(CauseCode.SERVICE_ENDED, detail=why)
        self._ending = self._ending or ending
        self.epochs.begin(ending)
        self._port.halt()
        if first and self._user is not None:
            self._tell("end of the service", replace(ending, detail=f"{why} while {self._user} was in progress"))

    def broke_off(self, user: str, cause: Cause) -> None:
        """Its user ended by its own error, and the axes stand. Reported, unless the reason was reported before."""
        if self.cause is None:
            self._tell(user, cause)

    async def reset_stop(self, by: str, stops: Sequence[int]) -> tuple[StopDocument, ...]:
        """A person checked the machine and releases these stops; motion is allowed when none remains. Causes no motion.

        Stops that are already released stay so. NotFound if one does not exist, Conflict while one is in progress.
        """
        released = await self._holds.reset(by, stops)
        if not self._holds.documents:
            self._port.allow()
        _log.warning("stop_reset", by=by, stops=list(stops))
        return released

    async def noted(self) -> None:
        """Wait until the database has stored every stop."""
        await self._holds.noted()

    async def close(self) -> None:
        """End of the service: entries that the database refuses now are lost."""
        await self._sequences.close()
        await self._background.settle()
        await self._holds.close()

    @property
    def forbidden(self) -> str:
        """Why motion is blocked although the drives answer; "" if it is allowed."""
        return str(self._forbidden or "")

    @property
    def _forbidden(self) -> Cause | None:
        held = self.latched
        return self._ending or self._lease_trouble if held is None else _stopped(held)

    @property
    def cause(self) -> Cause | None:
        """Why motion is blocked although the drives answer, or what stopped its present or last user."""
        return self._forbidden or (None if self._intention is None else self.epochs.since(self._intention))

    @property
    def held(self) -> str:
        """The sentence of `cause`; "" if there is none."""
        return str(self.cause or "")

    def check_may_move(self, intention: Intention) -> None:
        """Raises Conflict while stopped, without lease or not connected; Superseded if the intention is older than one
        of these, also after its release.
        """
        if reason := self.forbidden:
            raise Conflict(f"the machine may not move: {reason}")
        self.epochs.check(intention)
        self._check_connected()

    @contextmanager
    def used_by(self, user: str, intention: Intention) -> Generator[None]:
        """During the block, only this user connects, acknowledges or moves. Raises Conflict if the machine is in
        use.
        """
        self._check_unused(user)
        self._user, self._intention = user, intention
        try:
            yield
        finally:
            self._user = None

    @asynccontextmanager
    async def motion(self, envelope: Bounds, intention: Intention) -> AsyncGenerator[MotionAccess]:
        """The gate to motion, only for the present user, during the block (see `motion`)."""
        if self._user is None:
            raise Conflict("the machine is not reserved by a campaign: it may not be moved")
        permitted = partial(self.check_may_move, intention)
        motion = MotionAccess(self._port, envelope, permitted, self.lost, self._reports)
        try:
            yield motion
        except BaseException as error:
            await run_to_end(motion.end(error))
            raise
        else:
            await motion.end(None)
        finally:
            self._reports.gave_energy_up(self.joints)

    async def keep_lease(self, lease: MachineLease, lease_time: float) -> None:
        """Renew the lease until another service has it. While it cannot be renewed (database blocked), the machine
        stands.

        It also stands, until a restart, if this task ends by an unexpected error.
        """
        try:
            await renew(lease, lease_time, self._renewed, self._stop_quietly)
        except LeaseLost as error:
            _log.error("lease_lost")
            await self._let_go(Cause(CauseCode.LEASE_LOST, detail=f"{error}; restart this service"))
        except Exception as error:
            _log.error("lease_watch_broke_off", exc_info=error)
            why = f"renewal of the machine lease has ended: {error!r}; restart this service"
            await self._let_go(Cause(CauseCode.INTERNAL, detail=why))
            raise

    def _renewed(self) -> None:
        self._lease_trouble = None

    async def _let_go(self, why: Cause) -> None:
        """Stop and leave the bus permanently: our heartbeat would hide the loss of the host from the drives."""
        self._lease_over = True
        await self._stop_quietly(why)
        async with self._connecting:
            await self._port.close()
            self.lost(str(why), why)

    async def _stop_quietly(self, why: Cause) -> None:
        self._lease_trouble = why
        self.epochs.begin(why)
        self._tell("lease", why)
        try:
            await self._port.stop()
        except DriveError as error:
            _log.error("stop_not_confirmed", reason=str(error))
            self.lost(str(error), error.cause)

    def _check_connected(self) -> None:
        if self._trouble:
            raise Conflict(f"the machine is not connected: {self._trouble}")

    def _check_unused(self, what: str) -> None:
        if self._user is not None:
            raise Conflict(f"{what}: the machine is in use by {self._user}")


def _stopped(stop: StopDocument) -> Cause:
    return replace(stop.cause or Cause(CauseCode.STOPPED), by=stop.by, detail=stop.why)


@asynccontextmanager
async def listening(
    process: StopProcess, machine: Machine, report: Callable[[str, str, str], None]
) -> AsyncGenerator[None]:
    """Receive from the stop process during the block, and handle the stops from before it.

    `report` is called with source, reason and address of each new stop after the machine is held; it does not wait.
    """
    async with _holding(machine) as hold:

        def word(by: str, why: str, press: str, address: str) -> None:
            taken = hold(by, why, press, f"{address} {by}")
            process.taken_over()
            if not taken.reported:
                taken.reported = True
                report(by, why, address)

        process.attach(word)
        try:
            yield
        finally:
            process.attach(None)


@asynccontextmanager
async def watching(machine: Machine, report: Callable[[str, Cause], None]) -> AsyncGenerator[None]:
    """Receive the findings of the host watch during the block. `report`: called with source and cause, as in
    `listening`.
    """
    async with _holding(machine) as hold:

        def found(cause: Cause) -> None:
            hold("host watch", f"{cause}; check the machine, release this stop and resume", "", "", cause)
            report("host watch", cause)

        machine.watch(found)
        try:
            yield
        finally:
            machine.watch(None)


@asynccontextmanager
async def _holding(machine: Machine) -> AsyncGenerator[Callable[..., Hold]]:
    """A function that holds the machine (arguments of `Machine.latch`); may be called from any thread."""
    loop, confirming = asyncio.get_running_loop(), Background()
    pressed: list[Hold] = []  # since the last turn of the loop: a flood must not delay the stop of another
    adding = threading.Lock()

    def follow() -> None:
        with adding:
            holds, pressed[:] = pressed[:], []
        for hold in {id(each): each for each in holds}.values():
            presses = sum(each is hold for each in holds)
            confirming.begin("confirm a stop", machine.confirm_logged(hold, presses))

    def hold_at_once(by: str, why: str, press: str, source: str, cause: Cause | None = None) -> Hold:
        hold = machine.latch(by, why, press, source, cause)
        with adding:
            pressed.append(hold)
            first = len(pressed) == 1
        if first:
            loop.call_soon_threadsafe(follow)
        return hold

    try:
        yield hold_at_once
    finally:
        await asyncio.sleep(0)  # run the pending callbacks
        await confirming.settle()
