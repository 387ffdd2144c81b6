"""Runs one sweep on the machine: move to the pose, enable, sweep, disable, recording. Any error: standstill first.

The samples of a running sweep, or of those of a trajectory, as they arrive: monitored, published, written.
"""

import asyncio
import math
import time
from collections import deque
from collections.abc import AsyncIterable, Awaitable, Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import structlog
from sqlalchemy.exc import SQLAlchemyError

from drivers.errors import Cause, CauseCode, CausedError, DriveError, SweepInterrupted
from drivers.ports import AxisStatus, SampleBlock, SweepCommand
from service import EnvelopeViolation, SweepidError
from service.machine.execution.check_move import DURATION, WAY, CheckMove, make
from service.machine.execution.energising import Intention
from service.machine.execution.machine import Machine
from service.machine.execution.motion import Command, MotionAccess
from service.machine.execution.sweep_samples import Gapless, Recorder, break_off, end_runs, finish, store_streams
from service.model import SweepSpec
from service.model.results.spectrum import Facts
from service.planning.campaigns.live import LiveHub
from service.planning.campaigns.state_machine import SweepEvent, sweep_move
from service.planning.compiled_plan import CompiledPlan, positions_of
from service.planning.safety.travel import Leg
from service.process.logs import MACHINE, in_executor
from service.process.tasks import run_to_end
from service.process.telemetry import TRACING
from service.store.database import refusal
from service.store.documents import NewRecording, SweepDocument
from service.store.files.recordings import RecordingFiles, SweepAttempt
from service.store.store import Store


@dataclass(frozen=True, slots=True)
class BegunSweep:
    """A sweep in progress."""

    sweep: SweepDocument
    run: SweepAttempt
    command: Command
    facts: Facts


class Incoming:
    """Samples of sweeps that run together.

    They are monitored as they arrive, independent of the disk: blocks wait in memory, at most all samples of these
    sweeps. `stop` stops the machine; `disk` is the one thread that writes.
    """

    def __init__(
        self,
        together: Sequence[BegunSweep],
        compiled: CompiledPlan,
        stop: Callable[[], Awaitable[None]],
        hub: LiveHub,
        disk: ThreadPoolExecutor,
    ) -> None:
        self._together, self._compiled, self._stop, self._hub, self._disk = together, compiled, stop, hub, disk
        self._by_joint = {each.command.joint: each for each in together}
        self._came = {joint: Gapless() for joint in self._by_joint}
        self._recorders: dict[str, Recorder] = {}
        self._streams = ExitStack()  # of the disk's thread alone: an opening may end after its waiter was cancelled
        self._writes: deque[Future[None]] = deque()
        self._off_path: EnvelopeViolation | None = None  # how an axis left its path in a trajectory

    @property
    def waiting(self) -> int:
        """Number of blocks that are not yet on disk."""
        return len(self._writes)

    async def open(self, files: RecordingFiles) -> None:
        """Create a stream for each sweep. Raises OSError."""
        for joint, each in self._by_joint.items():
            stream = files.stream(each.run)
            self._recorders[joint] = await in_executor(self._disk, self._open, stream, each.command)

    async def take(self, blocks: AsyncIterable[SampleBlock]) -> None:
        """Take all blocks, to the end of the sweep.

        Raises EnvelopeViolation if an axis leaves its envelope or its path; the machine is then stopped. An axis that
        already brakes leaves its path as well: then the error is the cause of the braking.
        """
        try:
            async for block in blocks:
                await self._take(block)
        except SweepInterrupted as stopped:  # any other error came before: braking axes leave their path
            raise self._off_path or stopped from None
        if self._off_path is not None:
            raise self._off_path

    async def written(self) -> None:
        """Wait until all is on disk. Raises SamplesMissing if the samples end before the measured window."""
        for write in self._writes:
            await run_to_end(asyncio.wrap_future(write))
        for recorder in self._recorders.values():
            recorder.check_complete()

    def close(self) -> None:
        """Close the streams. Does not wait for the disk: after an error the axes have priority."""
        self._disk.submit(self._streams.close)

    def _open(self, stream: Path, command: Command) -> Recorder:
        recorder = Recorder(stream, command)
        self._streams.callback(recorder.close)
        return recorder

    async def _take(self, block: SampleBlock) -> None:
        each = self._by_joint.get(block.joint, self._together[0])
        joint = each.command.joint
        self._writes.append(self._disk.submit(self._recorders[joint].write, block))
        if self._off_path is None:
            await self._watch(each, block)
        self._hub.publish(each.run.campaign_id, each.run.number, block)
        if self._off_path is None:
            self._came[joint].check(block)
        self._came[joint].add(block)
        while self._writes and self._writes[0].done():
            self._writes.popleft().result()  # a write error ends the sweep

    async def _watch(self, each: BegunSweep, block: SampleBlock) -> None:
        """Stop the machine if the axis left its envelope, with EnvelopeViolation, or its path in a trajectory."""
        try:
            self._compiled.envelope.watch(each.command, block)
        except EnvelopeViolation:
            await self._stop_now()
            raise
        if len(self._together) == 1 or not isinstance(each.command, SweepCommand):
            return
        start = each.sweep.spec.pose[self._compiled.joints.index(block.joint)]
        try:
            self._compiled.envelope.watch_path(each.command, start, block)
        except EnvelopeViolation as left:
            self._off_path = left
            await self._stop_now()

    async def _stop_now(self) -> None:
        """What is not confirmed is told at the end of the motion, which stops once more, beside the cause of it all."""
        with suppress(DriveError):
            await self._stop()


@dataclass(frozen=True, slots=True)
class Travel:
    """One joint moves to `target`, rad (m); `seconds` at the speed of moves between poses."""

    joint: str
    target: float
    seconds: float


@dataclass(frozen=True, slots=True)
class CurrentActivity:
    """A sweep, or those of a trajectory, with the remaining moves to its pose.

    `travels`: the first one is in progress, the others follow; empty: the sweep itself. `seconds`: of the sweep.
    `checked`: joints that made their check move since the last start or resume. `begun`: monotonic clock, s.
    """

    numbers: tuple[int, ...]
    joints: tuple[str, ...]
    travels: tuple[Travel, ...]
    seconds: float
    checked: frozenset[str]
    begun: float


def travels(joints: Sequence[str], here: Sequence[float], legs: Sequence[Leg], velocity: float) -> tuple[Travel, ...]:
    """Moves from the pose `here`, rad (m), at `velocity`, rad/s (m/s)."""
    pose = list(here)
    found: list[Travel] = []
    for index, target in legs:
        found.append(Travel(joints[index], target, abs(target - pose[index]) / velocity))
        pose[index] = target
    return tuple(found)


_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class CampaignCourse:
    """What the sweeps between a start or resume of a campaign and its end have in common.

    `origin`: start of the campaign on the monotonic clock, s. `recorded` is called for each sweep that is stored as
    recorded, whatever is raised afterwards. `checked`: the joints that made their check move since then.
    """

    compiled: CompiledPlan
    origin: float
    recorded: Callable[[SweepDocument], None]
    checked: set[str] = field(default_factory=set[str])


class SweepExecutor:
    """Runs sweeps: one at a time, or those of one trajectory together."""

    def __init__(self, store: Store, files: RecordingFiles, machine: Machine, hub: LiveHub) -> None:
        self._store, self._files, self._machine, self._hub = store, files, machine, hub
        self.under_way: CurrentActivity | None = None
        self.check_move: CheckMove | None = None
        """First direction of the check move in progress, so that a person can check the motion of the axis."""
        self.set_points = self.set_points_missed = 0
        """Of all streamed sweeps since the start of the service."""
        self._incoming: Incoming | None = None
        # one thread: writing a file and processing it afterwards never overlap, even when cancelled
        self._disk = ThreadPoolExecutor(1, thread_name_prefix="recorder")

    @property
    def blocks_waiting(self) -> int:
        """Number of blocks of samples that are not yet on disk."""
        return 0 if self._incoming is None else self._incoming.waiting

    def close(self) -> None:
        """Wait for the disk."""
        self._disk.shutdown()

    async def run(self, sweeps: Sequence[SweepDocument], course: CampaignCourse, intention: Intention) -> None:
        """Run a planned sweep, or the sweeps of one trajectory together.

        Whatever is raised (also on cancellation): the machine stands, each sweep that is not recorded is failed or
        interrupted with its cause, and its samples are kept as a partial recording. If the database refuses that,
        `end_runs` repeats it.
        """
        campaign, numbers, compiled = sweeps[0].campaign_id, [sweep.number for sweep in sweeps], course.compiled
        left: list[BegunSweep] = []  # started, and not recorded yet
        span = TRACING.span("sweep", campaign=campaign, sweep=numbers[0], together=len(numbers))
        with MACHINE.sweeps(campaign, numbers), span:
            try:
                async with self._machine.motion(compiled.envelope, intention) as motion:
                    await run_to_end(asyncio.to_thread(self._begin, sweeps, compiled, left))
                    together = tuple(left)
                    commands, pose = [each.command for each in together], together[0].sweep.spec.pose
                    await asyncio.to_thread(compiled.envelope.check_run, commands, pose)
                    with TRACING.span("approach"):
                        here = await self._approach(motion, together, course)
                    started_at = time.monotonic() - course.origin
                    with TRACING.span("record"):
                        await self._record(motion, together, compiled, here)
                    here = await self._pose(together[0].sweep, compiled)  # measured again: a brake may have slipped
                    moved = {command.joint for command in commands}
                    compiled.envelope.check_standing(pose, here, compiled.pose_tolerance, moving=moved)
                    for each, (spec, recording) in [(each, await self._finish(each, started_at)) for each in together]:
                        await run_to_end(self._keep(each, spec, recording, left, course.recorded))
            except BaseException as error:
                await run_to_end(self._give_up(left, error))
                raise
            finally:
                self.under_way = None

    async def end_runs(self, cause: Cause) -> None:
        """Store that nothing runs any more, if the database refused it before. Raises SQLAlchemyError if it
        still does.
        """
        await in_executor(self._disk, end_runs, self._store, self._files, cause, cause)

    async def store_streams(self) -> None:
        """Store the samples of earlier sweeps that could not be written when they ended. Raises SQLAlchemyError."""
        await in_executor(
            self._disk, store_streams, self._store, self._files, "the disk did not accept it when the sweep ended"
        )

    def _begin(self, sweeps: Sequence[SweepDocument], compiled: CompiledPlan, begun: list[BegunSweep]) -> None:
        """Begin them in the store; `begun` receives those that were begun, also if one is refused."""
        for planned in sweeps:
            command = compiled.commands[planned.number]
            last = self._files.last_attempt(planned.campaign_id, planned.number)
            sweep = self._store.begin_sweep(planned.campaign_id, planned.number, sweep_move(SweepEvent.BEGIN), last)
            run = SweepAttempt(sweep.campaign_id, sweep.number, sweep.attempt)
            facts: Facts = {
                "campaign_id": run.campaign_id,
                "number": run.number,
                "attempt": run.attempt,
                "spec": sweep.spec.model_dump(mode="json"),
                "drives": [asdict(identity) for identity in self._machine.identities],
            }
            begun.append(BegunSweep(sweep, run, command, facts))
            _log.info("sweep_begun", campaign=run.campaign_id, sweep=run.number, attempt=run.attempt)

    async def _finish(self, each: BegunSweep, started_at: float) -> tuple[SweepSpec, NewRecording]:
        """The recording of a sweep that ran, and its spec as measured."""
        spec = each.sweep.spec.model_copy(update={"started_at": started_at})
        streamed = self._machine.set_point_timing
        if streamed is not None:
            self.set_points += streamed.cycles
            self.set_points_missed += streamed.missed
        each.facts["set_point_timing"] = None if streamed is None else asdict(streamed)
        timing = self._machine.channel_timing[each.command.joint]
        return await in_executor(self._disk, finish, self._files, each.run, spec, each.command, timing, each.facts)

    async def _keep(
        self,
        each: BegunSweep,
        spec: SweepSpec,
        recording: NewRecording,
        left: list[BegunSweep],
        recorded: Callable[[SweepDocument], None],
    ) -> None:
        """Store a recorded sweep; its stream is removed after the row of its recording is stored."""
        run, move = each.run, sweep_move(SweepEvent.RECORD)
        sweep = await in_executor(
            self._disk, self._store.end_sweep, run.campaign_id, run.number, move, spec=spec, recording=recording
        )
        left.remove(each)
        recorded(sweep)
        _log.info("recorded", campaign=run.campaign_id, sweep=run.number, axis=spec.axis)
        await in_executor(self._disk, self._files.stream(run).unlink)

    async def _approach(
        self, motion: MotionAccess, together: Sequence[BegunSweep], course: CampaignCourse
    ) -> tuple[float, ...]:
        """Move the axes to the sweeps' pose, one at a time, and check their positions. Returns the measured pose.

        An axis makes its check move before any larger move and before its sweep.
        """
        sweep, commands, begun = together[0].sweep, [each.command for each in together], time.monotonic()
        compiled, checked = course.compiled, course.checked
        envelope, pose = compiled.envelope, sweep.spec.pose
        units = envelope.units()
        here = await self._pose(sweep, compiled)
        legs = await asyncio.to_thread(envelope.order_of_legs, here, pose)
        way = travels(compiled.joints, here, legs, compiled.move_velocity)
        numbers, joints = tuple(each.run.number for each in together), tuple(each.joint for each in commands)
        for done, (index, target) in enumerate(legs):
            joint = compiled.joints[index]
            left, seconds = way[done:], commands[0].duration
            self.under_way = CurrentActivity(numbers, joints, left, seconds, frozenset(checked), begun)
            here = await self._pose(sweep, compiled)
            if joint not in checked and abs(target - here[index]) > WAY[units[joint]]:
                await self._check(motion, joint, target - here[index], sweep, compiled)
                checked.add(joint)
                here = await self._pose(sweep, compiled)
            async with motion.moving(joint, here, target, compiled.move_velocity) as go:
                await go(target)
        self.under_way = CurrentActivity(numbers, joints, (), commands[0].duration, frozenset(checked), begun)
        for command in commands:
            if command.joint not in checked:
                await self._check(motion, command.joint, command.offset_velocity, sweep, compiled)
                checked.add(command.joint)
        here = await self._pose(sweep, compiled)
        envelope.check_standing(pose, here, compiled.pose_tolerance)
        await asyncio.to_thread(envelope.check_run, commands, here)  # before a file for samples is created
        return here

    async def _check(
        self, motion: MotionAccess, joint: str, towards: float, sweep: SweepDocument, compiled: CompiledPlan
    ) -> None:
        """The check move of a joint in the direction of `towards`, and back."""
        units = compiled.envelope.units()
        way = math.copysign(WAY[units[joint]], towards)
        velocity = min(compiled.move_velocity, abs(way) / DURATION)
        status = await self._machine.status()
        here = _pose_of(status, sweep, compiled)
        there = CheckMove(joint, way, {each: axis.position for each, axis in status.items()}, units)
        _log.info("check_move", campaign=sweep.campaign_id, sweep=sweep.number, axis=joint, way=way, unit=units[joint])
        self.check_move = there
        try:
            await asyncio.to_thread(
                self._store.add_check_move, sweep.campaign_id, sweep.number, joint, way, units[joint]
            )
            async with motion.moving(joint, here, there.target, velocity) as go:
                await make(go, there, self._machine.status)
                reached = {each: axis.position for each, axis in (await self._machine.status()).items()}
                back = CheckMove(joint, there.start[joint] - reached[joint], reached, units)
                await make(go, back, self._machine.status)
        finally:
            self.check_move = None

    async def _record(
        self, motion: MotionAccess, together: Sequence[BegunSweep], compiled: CompiledPlan, here: Sequence[float]
    ) -> None:
        """Run the sweeps and write their samples to disk. Raises SamplesMissing if any is missing."""
        self._incoming = incoming = Incoming(together, compiled, motion.stop, self._hub, self._disk)
        try:
            await incoming.open(self._files)
            async with motion.sweeping([each.command for each in together], here) as blocks:
                await incoming.take(blocks)
            await incoming.written()
        finally:
            self._incoming = None
            incoming.close()

    async def _pose(self, sweep: SweepDocument, compiled: CompiledPlan) -> tuple[float, ...]:
        """Positions of all axes; for axes that this machine does not reach, those of the plan.

        CommunicationLost if a drive does not answer, because the position of its axis is then unknown.
        """
        return _pose_of(await self._machine.status(), sweep, compiled)

    async def _give_up(self, left: Sequence[BegunSweep], error: BaseException) -> None:
        """The machine stands: `Machine.motion` ensured this before it raised the error."""
        interrupted = bool(self._machine.held) or isinstance(error, SweepInterrupted | asyncio.CancelledError)
        cause = cause_of(self._machine, error)
        event = SweepEvent.INTERRUPT if interrupted else SweepEvent.FAIL
        for each in left:
            await self._abandon(each, event, cause)

    async def _abandon(self, each: BegunSweep, event: SweepEvent, cause: Cause) -> None:
        """Keep the samples of a sweep, and end it in the store, if that is possible."""
        run = each.run
        _log.error("sweep_given_up", campaign=run.campaign_id, sweep=run.number, cause=str(cause))
        try:
            await in_executor(self._disk, break_off, self._store, self._files, run, event, cause, each.facts)
        except (SQLAlchemyError, SweepidError) as refused:  # the others must be ended as well
            _log.error("sweep_not_ended", campaign=run.campaign_id, sweep=run.number, reason=str(refused))


def _pose_of(status: Mapping[str, AxisStatus], sweep: SweepDocument, compiled: CompiledPlan) -> tuple[float, ...]:
    positions = positions_of(status)
    return tuple(positions.get(joint, planned) for joint, planned in zip(compiled.joints, sweep.spec.pose, strict=True))


def cause_of(machine: Machine, error: BaseException) -> Cause:
    """The cause for the person: who stopped the machine, or the error, with later notes."""
    cause = machine.cause or cause_of_error(error)
    return replace(cause, detail="; ".join([cause.detail, *getattr(error, "__notes__", ())]))


def cause_of_error(error: BaseException) -> Cause:
    told = f"{type(error).__name__}: {error}"
    match error:
        case asyncio.CancelledError(args=(Cause() as cause,)):
            return cause
        case CausedError():
            return error.cause
        case SQLAlchemyError():
            return Cause(CauseCode.NOT_STORED, detail=refusal(error))
        case OSError():
            return Cause(CauseCode.NOT_STORED, detail=told)
        case SweepidError():
            return Cause(CauseCode.REFUSED, detail=told)
        case _:
            return Cause(CauseCode.INTERNAL, detail=told)
