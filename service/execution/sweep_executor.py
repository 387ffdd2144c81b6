"""Runs one sweep at the machine: to the pose, energy on, sweep, energy off, recording. Any error: stand still first."""

import asyncio
import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from typing import ParamSpec, TypeVar

import structlog
from pydantic import JsonValue
from sqlalchemy.exc import SQLAlchemyError

from drivers.errors import CommunicationLost, SweepInterrupted
from drivers.ports import AxisState, AxisStatus, SampleBlock, SweepCommand
from service.campaigns.live import LiveHub
from service.campaigns.session import SweepEvent, sweep_move
from service.errors import EnvelopeViolation, SweepidError
from service.execution.check_move import DURATION, WAY, CheckMove, make
from service.execution.machine import Machine
from service.execution.motion import Motion
from service.execution.recording.recorder import Gapless, Recorder, finish
from service.execution.recording.recovery import break_off, end_runs
from service.execution.under_way import UnderWay, travels
from service.planning.compiled_plan import CompiledPlan
from service.recording import SweepSpec
from service.safety.noise_motion import Command
from service.store.database import refusal
from service.store.documents import EventKind, NewRecording, SweepDocument
from service.store.files.recordings import RecordingFiles, Run
from service.store.store import Store
from service.tasks.ending import to_its_end

_log = structlog.get_logger(__name__)

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class _Begun:
    """A sweep under way."""

    sweep: SweepDocument
    run: Run
    command: Command
    facts: dict[str, JsonValue]


class SweepExecutor:
    """Where sweeps are run: one at a time, or those of one trajectory at once."""

    def __init__(self, store: Store, files: RecordingFiles, machine: Machine, hub: LiveHub) -> None:
        self._store, self._files, self._machine, self._hub = store, files, machine, hub
        self.under_way: UnderWay | None = None
        self.check_move: CheckMove | None = None
        """The first way of the check move under way, so that a person can look whether that axis goes that way."""
        # one thread: what is written to a file and what is made of it afterwards never overlap, even when cancelled
        self._disk = ThreadPoolExecutor(1, thread_name_prefix="recorder")

    def close(self) -> None:
        """Wait for the disk."""
        self._disk.shutdown()

    async def run(
        self,
        sweeps: Sequence[SweepDocument],
        compiled: CompiledPlan,
        origin: float,
        checked: set[str],
        recorded: Callable[[SweepDocument], None],
    ) -> None:
        """Run a planned sweep, or the sweeps of one trajectory at once.

        `origin`: start of the campaign on the monotonic clock, s.

        `checked`: the joints that made their check move in this run of the campaign; those that make it now are added.

        `recorded` is told of each sweep that the store has as recorded, whatever is raised afterwards.

        Whatever is raised (also on cancellation): the machine stands, each sweep that is not recorded is failed or
        interrupted with its cause, and what came of samples is kept as a partial recording. Where the database
        refuses that, `end_runs` makes it good.
        """
        left: list[_Begun] = []  # begun, and not recorded yet
        try:
            async with self._machine.motion(compiled.envelope) as motion:
                await to_its_end(asyncio.to_thread(self._begin, sweeps, compiled, left))
                together = tuple(left)
                commands, pose = [each.command for each in together], together[0].sweep.spec.pose
                await asyncio.to_thread(compiled.envelope.check_run, commands, pose)
                here = await self._approach(motion, together, compiled, checked, time.monotonic())
                started_at = time.monotonic() - origin
                await self._record(motion, together, compiled, here)
                here = await self._pose(together[0].sweep, compiled)  # did the others stand? A brake may have slipped
                moved = {command.joint for command in commands}
                compiled.envelope.check_standing(pose, here, compiled.pose_tolerance, moving=moved)
                for each, (spec, recording) in [(each, await self._finish(each, started_at)) for each in together]:
                    await to_its_end(self._keep(each, spec, recording, left, recorded))
        except BaseException as error:
            await to_its_end(self._give_up(left, error))
            raise
        finally:
            self.under_way = None

    async def end_runs(self, cause: str) -> None:
        """Store that nothing runs any more, where the database refused it when it was due; SQLAlchemyError if still."""
        await self._on_disk(end_runs, self._store, self._files, cause, cause)

    def _begin(self, sweeps: Sequence[SweepDocument], compiled: CompiledPlan, begun: list[_Begun]) -> None:
        """Begin them in the store; `begun` has those that were, also where one is refused."""
        for planned in sweeps:
            command = compiled.commands[planned.number]
            last = self._files.last_attempt(planned.campaign_id, planned.number)
            sweep = self._store.begin_sweep(planned.campaign_id, planned.number, sweep_move(SweepEvent.BEGIN), last)
            run = Run(sweep.campaign_id, sweep.number, sweep.attempt)
            facts: dict[str, JsonValue] = {
                **asdict(run),
                "spec": sweep.spec.model_dump(mode="json"),
                "drives": [asdict(identity) for identity in self._machine.identities],
            }
            begun.append(_Begun(sweep, run, command, facts))

    async def _finish(self, each: _Begun, started_at: float) -> tuple[SweepSpec, NewRecording]:
        """The recording of a sweep that ran, and its spec as measured."""
        spec = each.sweep.spec.model_copy(update={"started_at": started_at})
        streamed = self._machine.set_point_timing
        each.facts["set_point_timing"] = None if streamed is None else asdict(streamed)
        timing = self._machine.channel_timing[each.command.joint]
        return await self._on_disk(finish, self._files, each.run, spec, each.command, timing, each.facts)

    async def _keep(
        self,
        each: _Begun,
        spec: SweepSpec,
        recording: NewRecording,
        left: list[_Begun],
        recorded: Callable[[SweepDocument], None],
    ) -> None:
        """The end of a sweep that was recorded; its stream goes once its recording's row is there."""
        run, move = each.run, sweep_move(SweepEvent.RECORD)
        sweep = await self._on_disk(
            self._store.end_sweep, run.campaign_id, run.number, move, spec=spec, recording=recording
        )
        left.remove(each)
        recorded(sweep)
        _log.info("recorded", campaign=run.campaign_id, sweep=run.number, axis=spec.axis)
        await self._on_disk(self._files.stream(run).unlink)

    async def _approach(
        self, motion: Motion, together: Sequence[_Begun], compiled: CompiledPlan, checked: set[str], begun: float
    ) -> tuple[float, ...]:
        """Bring the axes to the sweeps' pose, one at a time; then check that they are there: the pose as measured.

        An axis makes its check move before it goes further than that, and before it is swept.
        """
        sweep, commands = together[0].sweep, [each.command for each in together]
        envelope, pose = compiled.envelope, sweep.spec.pose
        units = envelope.units()
        here = await self._pose(sweep, compiled)
        legs = await asyncio.to_thread(envelope.order_of_legs, here, pose)
        way = travels(compiled.joints, here, legs, compiled.move_velocity)
        numbers, joints = tuple(each.run.number for each in together), tuple(each.joint for each in commands)
        for done, (index, target) in enumerate(legs):
            joint = compiled.joints[index]
            left, seconds = way[done:], commands[0].duration
            self.under_way = UnderWay(numbers, joints, left, seconds, frozenset(checked), begun)
            here = await self._pose(sweep, compiled)
            if joint not in checked and abs(target - here[index]) > WAY[units[joint]]:
                await self._check(motion, joint, target - here[index], sweep, compiled)
                checked.add(joint)
                here = await self._pose(sweep, compiled)
            async with motion.moving(joint, here, target, compiled.move_velocity) as go:
                await go(target)
        self.under_way = UnderWay(numbers, joints, (), commands[0].duration, frozenset(checked), begun)
        for command in commands:
            if command.joint not in checked:
                await self._check(motion, command.joint, command.offset_velocity, sweep, compiled)
                checked.add(command.joint)
        here = await self._pose(sweep, compiled)
        envelope.check_standing(pose, here, compiled.pose_tolerance)
        await asyncio.to_thread(envelope.check_run, commands, here)  # before there is a file for samples
        return here

    async def _check(
        self, motion: Motion, joint: str, towards: float, sweep: SweepDocument, compiled: CompiledPlan
    ) -> None:
        """The check move of a joint in the direction of `towards`, and back."""
        units = compiled.envelope.units()
        way = math.copysign(WAY[units[joint]], towards)
        velocity = min(compiled.move_velocity, abs(way) / DURATION)
        status = await self._machine.status()
        here = _pose_of(status, sweep, compiled)
        there = CheckMove(joint, way, {each: axis.position for each, axis in status.items()}, units)
        _log.info("check_move", campaign=sweep.campaign_id, sweep=sweep.number, axis=joint, way=way, unit=units[joint])
        told: dict[str, JsonValue] = {"number": sweep.number, "axis": joint, "way": way, "unit": units[joint]}
        self.check_move = there
        try:
            await asyncio.to_thread(self._store.add_event, sweep.campaign_id, EventKind.CHECK_MOVE, told)
            async with motion.moving(joint, here, there.target, velocity) as go:
                await make(go, there, self._machine.status)
                reached = {each: axis.position for each, axis in (await self._machine.status()).items()}
                back = CheckMove(joint, there.start[joint] - reached[joint], reached, units)
                await make(go, back, self._machine.status)
        finally:
            self.check_move = None

    async def _record(
        self, motion: Motion, together: Sequence[_Begun], compiled: CompiledPlan, here: Sequence[float]
    ) -> None:
        """Run the sweeps and stream their samples to the disk; SamplesMissing if there are not all of them.

        The samples are watched as they come, however slow the disk is: what it has not taken yet waits in memory, at
        most the samples of these sweeps.
        """
        recorders: list[Recorder] = []
        writes: deque[Future[None]] = deque()
        try:
            for each in together:
                recorders.append(await self._on_disk(Recorder, self._files.stream(each.run), each.command))
            by_joint = {each.command.joint: (each, own) for each, own in zip(together, recorders, strict=True)}
            came = {joint: Gapless() for joint in by_joint}
            async with motion.sweeping([each.command for each in together], here) as blocks:
                async for block in blocks:
                    each, recorder = by_joint.get(block.joint, (together[0], recorders[0]))
                    writes.append(self._disk.submit(recorder.write, block))
                    await self._watch(motion, each, compiled, block, on_path=len(together) > 1)
                    self._hub.publish(each.run.campaign_id, each.run.number, block)
                    came[each.command.joint].check(block)
                    came[each.command.joint].add(block)
                    while writes and writes[0].done():
                        writes.popleft().result()  # what the disk does not take ends the sweep
            for write in writes:
                await to_its_end(asyncio.wrap_future(write))
            for recorder in recorders:
                recorder.check_complete()
        finally:
            for recorder in recorders:
                self._disk.submit(recorder.close)  # not waited for: after an error the axes come first

    async def _watch(
        self, motion: Motion, each: _Begun, compiled: CompiledPlan, block: SampleBlock, *, on_path: bool
    ) -> None:
        """EnvelopeViolation, with the machine stopped, if the axis left its envelope or its path in a trajectory."""
        try:
            compiled.envelope.watch(each.command, block)
            if on_path and isinstance(each.command, SweepCommand):
                start = each.sweep.spec.pose[compiled.joints.index(block.joint)]
                compiled.envelope.watch_path(each.command, start, block)
        except EnvelopeViolation:
            await motion.stop()
            raise

    async def _pose(self, sweep: SweepDocument, compiled: CompiledPlan) -> tuple[float, ...]:
        """Where the axes stand; those that this machine does not reach are taken to be where the plan says.

        CommunicationLost where a drive does not answer: what its axis does is not known then.
        """
        return _pose_of(await self._machine.status(), sweep, compiled)

    async def _give_up(self, left: Sequence[_Begun], error: BaseException) -> None:
        """The machine stands: `Machine.motion` has seen to that before it let the error out."""
        interrupted = bool(self._machine.held) or isinstance(error, SweepInterrupted | asyncio.CancelledError)
        cause = cause_of(self._machine, error)
        event = SweepEvent.INTERRUPT if interrupted else SweepEvent.FAIL
        for each in left:
            await self._abandon(each, event, cause)

    async def _abandon(self, each: _Begun, event: SweepEvent, cause: str) -> None:
        """Keep what came of a sweep's samples, and end it in the store, if that takes it."""
        run = each.run
        _log.error("sweep_given_up", campaign=run.campaign_id, sweep=run.number, cause=cause)
        try:
            await self._on_disk(break_off, self._store, self._files, run, event, cause, each.facts)
        except (SQLAlchemyError, SweepidError) as refused:  # the others are ended all the same
            _log.error("sweep_not_ended", campaign=run.campaign_id, sweep=run.number, reason=str(refused))

    async def _on_disk(
        self, work: Callable[Arguments, Result], *args: Arguments.args, **kwargs: Arguments.kwargs
    ) -> Result:
        return await asyncio.get_running_loop().run_in_executor(self._disk, partial(work, *args, **kwargs))


def _pose_of(status: Mapping[str, AxisStatus], sweep: SweepDocument, compiled: CompiledPlan) -> tuple[float, ...]:
    for joint, axis in status.items():
        if axis.state is AxisState.UNKNOWN:
            raise CommunicationLost(f"{joint}: its drive does not answer")
    return tuple(
        status[joint].position if joint in status else planned
        for joint, planned in zip(compiled.joints, sweep.spec.pose, strict=True)
    )


def cause_of(machine: Machine, error: BaseException) -> str:
    """What a person is told: who stopped the machine, or what went wrong, and what was noted of it since."""
    if machine.held:
        cause = machine.held
    elif isinstance(error, asyncio.CancelledError):
        cause = str(error) or "cancelled"
    elif isinstance(error, SQLAlchemyError):
        cause = refusal(error)
    else:
        cause = f"{type(error).__name__}: {error}"
    return "; ".join([cause, *getattr(error, "__notes__", ())])
