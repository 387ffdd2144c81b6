"""The operator's commands, and the task that runs the sweeps of one campaign. No motion is repeated automatically."""

import asyncio
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from functools import partial
from types import MappingProxyType
from typing import Protocol

import structlog
from sqlalchemy.exc import SQLAlchemyError

from drivers.errors import Cause, CauseCode, DriveError
from service import Conflict, NotFound, SweepidError
from service.machine.execution.check_move import CheckMove
from service.machine.execution.energising import Approvals, Intention, SignOfLife
from service.machine.execution.machine import Machine
from service.machine.execution.sweep_executor import CampaignCourse, CurrentActivity, SweepExecutor, cause_of
from service.planning.campaigns.state_machine import CampaignEvent, SweepEvent, campaign_move, sweep_move
from service.planning.campaigns.stored_results import confidence_reached
from service.planning.compiled_plan import CompiledPlan, Range, check_seen, positions_of
from service.process.logs import MACHINE
from service.process.tasks import run_to_end
from service.process.telemetry import TRACING
from service.store.database import refusal
from service.store.documents import CampaignDocument, CampaignState, SweepDocument, SweepState
from service.store.store import CampaignMove, StaleVersion, Store, SweepMove

_log = structlog.get_logger(__name__)


class Identification(Protocol):
    """Where recorded sweeps go: `service.jobs`."""

    def submit(self, sweep: SweepDocument) -> None:
        """Identify a recorded sweep; returns at once."""
        ...

    async def settle(self, campaign_id: int) -> None:
        """Complete a measured campaign, if no sweep is left to identify."""
        ...


class Runner:
    """The commands of an operator. Each returns the campaign after it. Raises Conflict if it is not possible in this
    state.
    """

    retry = 2.0  # s between attempts to store the end of a campaign

    def __init__(
        self,
        store: Store,
        machine: Machine,
        executor: SweepExecutor,
        jobs: Identification,
        compile_plan: Callable[[CampaignDocument], CompiledPlan],
        approvals: Approvals,
    ) -> None:
        """`compile_plan` reads the plan of a campaign (blocking; BadInput or Conflict if it cannot be run here)."""
        self._store, self._machine, self._executor, self._jobs = store, machine, executor, jobs
        self._compile, self._approvals = compile_plan, approvals
        self._commands = asyncio.Lock()  # one command at a time; `Machine.stop` does not wait for it
        self._task: asyncio.Task[None] | None = None
        self._running: int | None = None
        self._attendance: SignOfLife | None = None  # of the running campaign
        self._origins: dict[int, float] = {}  # starts of campaigns on the monotonic clock, s
        self._unstored: Cause | None = None  # of the last campaign's end, until it is stored; no motion before

    @property
    def running(self) -> int | None:
        """The campaign that owns the machine, or None."""
        return self._running

    @property
    def attendance(self) -> SignOfLife | None:
        """The sign of life required by the running campaign, or None."""
        return self._attendance

    @property
    def unstored(self) -> str:
        """The end of a campaign that is not stored yet, with its reason; empty if all is stored."""
        return f"the end of a campaign is not stored yet: {self._unstored}" if self._unstored else ""

    @property
    def check_move(self) -> CheckMove | None:
        """The check move in progress, or None."""
        return self._executor.check_move

    @property
    def under_way(self) -> CurrentActivity | None:
        """Present and next motion of the campaign that owns the machine, or None."""
        return self._executor.under_way

    async def start(
        self,
        campaign_id: int,
        intention: Intention,
        if_version: int | None = None,
        attended: float | None = None,
        seen: Mapping[str, Range] | None = None,
    ) -> CampaignDocument:
        """planned -> running. Raises Conflict while another campaign runs, the machine is stopped or does not answer,
        or the plan is not approved if that is required; Superseded if the intention is older than a stop.

        `attended`: maximum time between two calls of `sign_of_life`, s; otherwise the axes stop and the campaign is
        paused. None: not required. `seen`: ranges of the axes, rad (m), that were shown before; Conflict if an axis has
        left them (`ahead`). None: none were shown.
        """
        return await self._launch(campaign_id, CampaignEvent.START, intention, if_version, attended, seen, repeat=False)

    async def pause(self, campaign_id: int, if_version: int | None = None) -> CampaignDocument:
        """running -> pausing; paused at the end of the present sweep."""
        async with self._commands:
            await self._tell()
            return await asyncio.to_thread(
                self._store.move_campaign, campaign_id, campaign_move(CampaignEvent.PAUSE), None, if_version
            )

    async def resume(
        self,
        campaign_id: int,
        intention: Intention,
        if_version: int | None = None,
        repeat: bool = False,
        attended: float | None = None,
        seen: Mapping[str, Range] | None = None,
    ) -> CampaignDocument:
        """paused -> running with the next planned sweep; with `repeat`, failed and interrupted sweeps are planned again
        first.

        Also cancels a requested pause (pausing -> running): `attended` None then keeps the condition of the start.
        Raises as `start`.
        """
        if self._running == campaign_id:
            async with self._commands:
                return await run_to_end(self._take_back_pause(campaign_id, intention, if_version, attended))
        return await self._launch(campaign_id, CampaignEvent.RESUME, intention, if_version, attended, seen, repeat)

    async def _take_back_pause(
        self, campaign_id: int, intention: Intention, if_version: int | None, attended: float | None
    ) -> CampaignDocument:
        move = self._if_wanted(_take_back_pause, intention)
        campaign = await asyncio.to_thread(self._store.move_campaign, campaign_id, move, None, if_version)
        if attended is not None and self._running == campaign_id:
            self._attend(campaign_id, attended)
        return campaign

    def sign_of_life(self, campaign_id: int) -> SignOfLife | None:
        """Record a sign of life; returns the remaining time, s (None: not required). Conflict if it is not running."""
        if self._running != campaign_id:
            raise Conflict(f"campaign {campaign_id} is not running")
        if self._attendance is not None:
            self._attendance.renew()
        return self._attendance

    async def abort(self, campaign_id: int, why: str, if_version: int | None = None) -> CampaignDocument:
        """Stop the present sweep now and end the campaign; the remaining sweeps become skipped."""
        async with self._commands:
            campaign = await asyncio.to_thread(self._store.own_campaign, campaign_id)
            if if_version is not None and campaign.version != if_version:
                raise StaleVersion(f"campaign {campaign_id} is at version {campaign.version}, not {if_version}")
            campaign_move(CampaignEvent.ABORT)(campaign.state)
            if self._running == campaign_id:
                await self._end_task(Cause(CauseCode.ABORTED, detail=f"aborted: {why}"))
            await self._tell()
            return await asyncio.to_thread(
                self._store.move_campaign,
                campaign_id,
                campaign_move(CampaignEvent.ABORT),
                Cause(CauseCode.ABORTED, detail=why),
                None,
                {SweepState.PLANNED: sweep_move(SweepEvent.SKIP)},
            )

    async def close(self) -> None:
        """The service ends: stop the machine, leave the campaign paused."""
        async with self._commands:
            await self._end_task(Cause(CauseCode.SERVICE_ENDED, detail="the service ended"))

    async def finished(self) -> None:
        """Wait until no campaign runs."""
        while self._task is not None and not self._task.done():
            await asyncio.wait([self._task])

    async def check_free(self, intention: Intention) -> None:
        """Raises Conflict or DriveError if a campaign could not be started now. Connects drives that are not
        connected.
        """
        async with self._commands:
            await self._check_idle()
            await self._check_machine(intention)

    async def _check_idle(self) -> None:
        if self._running is not None:
            raise Conflict(f"campaign {self._running} is running")
        await self._tell()

    async def _check_machine(self, intention: Intention) -> None:
        self._machine.epochs.check(intention)  # no drive is connected for a command that is over
        await self._machine.reach()
        self._machine.check_may_move(intention)

    def _if_wanted(self, move: CampaignMove, intention: Intention) -> CampaignMove:
        """The transition, refused in its transaction if the machine may not move: the database may have waited."""

        def checked(state: CampaignState) -> CampaignState:
            self._machine.check_may_move(intention)
            return move(state)

        return checked

    async def _launch(
        self,
        campaign_id: int,
        event: CampaignEvent,
        intention: Intention,
        if_version: int | None,
        attended: float | None,
        seen: Mapping[str, Range] | None,
        repeat: bool,
    ) -> CampaignDocument:
        async with self._commands:
            await self._check_idle()
            campaign = await asyncio.to_thread(self._store.own_campaign, campaign_id)
            campaign_move(event)(campaign.state)
            compiled = await asyncio.to_thread(self._compile, campaign)
            approved = partial(self._approvals.check, campaign.plan_id, compiled.sha256, intention.by)
            await asyncio.to_thread(approved)
            await self._check_machine(intention)
            await asyncio.to_thread(approved)  # a stop in force at the first look ended it perhaps only at its release
            if seen is not None:
                await self._check_seen(seen, compiled, campaign_id, repeat)
            again = sweep_move(SweepEvent.REPEAT)
            campaign = await asyncio.to_thread(
                self._store.move_campaign,
                campaign_id,
                self._if_wanted(campaign_move(event), intention),
                None,
                if_version,
                {SweepState.FAILED: again, SweepState.INTERRUPTED: again} if repeat else {},
            )
            self._running = campaign_id
            self._task = asyncio.create_task(self._run(campaign, compiled, intention), name=f"campaign {campaign_id}")
            self._task.add_done_callback(self._ended)
            if attended is not None:
                self._attend(campaign_id, attended)
            return campaign

    def _attend(self, campaign_id: int, within: float) -> None:
        """From now on the running campaign requires a sign of life within this time, s."""
        if self._task is None:
            return
        if self._attendance is not None:
            self._attendance.end()
        self._attendance = SignOfLife(within, partial(self._missed, self._task, campaign_id))

    async def _check_seen(
        self, seen: Mapping[str, Range], compiled: CompiledPlan, campaign_id: int, repeat: bool
    ) -> None:
        due = compiled.due(await asyncio.to_thread(self._store.sweeps, campaign_id), repeat)
        if due:
            positions = positions_of(await self._machine.status())
            await asyncio.to_thread(check_seen, seen, compiled, due[0].spec.pose, positions)

    def _missed(self, task: asyncio.Task[None], campaign_id: int, cause: Cause) -> None:
        task.cancel(cause)
        self._machine.broke_off(f"campaign {campaign_id}", cause)

    async def _end_task(self, why: Cause) -> None:
        if self._task is not None and not self._task.done():
            self._task.cancel(why)
            await asyncio.wait([self._task])

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._running = None
        if self._attendance is not None:
            self._attendance.end()
            self._attendance = None
        if not task.cancelled() and (error := task.exception()) is not None:
            _log.error("campaign_broke_off", task=task.get_name(), exc_info=error)

    async def _run(self, campaign: CampaignDocument, compiled: CompiledPlan, intention: Intention) -> None:
        """The task: runs sweeps until none remains, the confidence is reached, a pause is requested, or an error
        occurs.
        """
        with MACHINE.campaign(campaign.id), TRACING.span("campaign", campaign=campaign.id):
            await self._measure(campaign, compiled, intention)

    async def _measure(self, campaign: CampaignDocument, compiled: CompiledPlan, intention: Intention) -> None:
        name = f"campaign {campaign.id}"
        try:
            with self._machine.used_by(name, intention):
                await self._executor.store_streams()
                origin = await asyncio.to_thread(self._origin, campaign, compiled)
                course = CampaignCourse(compiled, origin, self._jobs.submit)
                while await self._next_is_due(campaign.id):
                    sweeps = await asyncio.to_thread(self._store.sweeps, campaign.id)
                    due = compiled.due(sweeps)
                    known = await asyncio.to_thread(self._confidence_reached, campaign.id, compiled)
                    if not due or known:
                        in_parts = any(sweep.state is SweepState.PLANNED for sweep in sweeps)
                        parts = "the remaining trajectories were measured in part and can only be repeated completely"
                        skip = {SweepState.PLANNED: sweep_move(SweepEvent.SKIP)}
                        why = known or (parts if in_parts else "")
                        cause = Cause(CauseCode.SWEEPS_SKIPPED, detail=why) if why else None
                        await self._move(campaign.id, CampaignEvent.MEASURED, cause, skip)
                        await self._jobs.settle(campaign.id)
                        return
                    await self._executor.run(due, course, intention)
        except BaseException as error:
            # the executor brought the machine to standstill before it raised the error
            self._unstored = cause_of(self._machine, error)
            if not isinstance(error, asyncio.CancelledError):  # an abort, or the end of the service
                self._machine.broke_off(name, self._unstored)
            await self._tell_patiently(wait=not isinstance(error, asyncio.CancelledError))
            if not isinstance(error, DriveError | SweepidError | OSError | SQLAlchemyError):
                raise

    def _origin(self, campaign: CampaignDocument, compiled: CompiledPlan) -> float:
        """The start of a campaign on the monotonic clock, s. Reads the store.

        After a restart only the wall clock is available, and it may have been set meanwhile: the time continues
        after the end of the measured sweeps.
        """
        if campaign.id not in self._origins:
            now = datetime.now(UTC)
            ends = [
                sweep.spec.started_at + compiled.commands[sweep.number].duration
                for sweep in self._store.sweeps(campaign.id)
                if sweep.state in (SweepState.RECORDED, SweepState.IDENTIFIED)
            ]
            passed = max(0.0, (now - (campaign.started_at or now)).total_seconds(), *ends)
            self._origins[campaign.id] = time.monotonic() - passed
        return self._origins[campaign.id]

    async def _tell_patiently(self, *, wait: bool) -> None:
        """Store the end of a campaign that broke off, with retries while the database refuses it.

        Without `wait` (a caller waits for this task), or if cancelled: the next command stores it, or the next
        start.
        """
        refusals = 0
        while True:
            try:
                await run_to_end(self._tell())
                return
            except SQLAlchemyError as refused:
                refusals += 1
                if refusals == 1:
                    _log.error("end_not_stored", cause=str(self._unstored), reason=refusal(refused))
            if not wait:
                return
            await asyncio.sleep(self.retry)

    async def _tell(self) -> None:
        """Store the end of a campaign that broke off, if that is pending. Raises SQLAlchemyError if refused."""
        if self._unstored:
            await self._executor.end_runs(self._unstored)
            self._unstored = None

    async def _next_is_due(self, campaign_id: int) -> bool:
        campaign = await asyncio.to_thread(self._store.campaign, campaign_id)
        if campaign.state is CampaignState.PAUSING:
            try:
                held = Cause(CauseCode.PAUSED, detail="paused by request")
                await self._move(campaign_id, CampaignEvent.HELD, held)
            except Conflict:  # the pause was cancelled at this moment
                return await self._next_is_due(campaign_id)
            return False
        return campaign.state is CampaignState.RUNNING

    def _confidence_reached(self, campaign_id: int, compiled: CompiledPlan) -> str:
        """Why the latest estimate makes the remaining sweeps unnecessary, or ""."""
        if compiled.confidence is None:
            return ""
        try:
            estimate = self._store.estimate(campaign_id)
        except NotFound:
            return ""
        joints = {command.joint for command in compiled.commands.values()}
        return confidence_reached(estimate.content, joints, compiled.base_parameters, compiled.confidence)

    async def _move(
        self,
        campaign_id: int,
        event: CampaignEvent,
        cause: Cause | None = None,
        sweeps: Mapping[SweepState, SweepMove] = MappingProxyType({}),
    ) -> None:
        await asyncio.to_thread(self._store.move_campaign, campaign_id, campaign_move(event), cause, None, sweeps)
        _log.info("campaign", campaign=campaign_id, happened=event.value, cause=str(cause or ""))


def _take_back_pause(state: CampaignState) -> CampaignState:
    """pausing -> running while the task still runs. A paused campaign needs a new task."""
    if state is CampaignState.PAUSED:
        raise Conflict("the campaign was paused at this moment; resume it again")
    return campaign_move(CampaignEvent.RESUME)(state)
