"""Runs one sweep at the machine: to the pose, energy on, sweep, energy off, recording. Any error: stand still first."""

import asyncio
import math
import time
from collections.abc import AsyncGenerator, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import aclosing, asynccontextmanager
from dataclasses import asdict, dataclass
from functools import partial
from typing import ParamSpec, TypeVar

import structlog
from pydantic import JsonValue

from drivers.errors import CommunicationLost, DriveError, SweepInterrupted
from drivers.ports import AxisState, NoiseCommand, SampleBlock, SweepCommand
from service.campaigns.check_move import DURATION, WAY, CheckMove, make
from service.campaigns.course import Course
from service.campaigns.live import LiveHub
from service.campaigns.machine import Machine
from service.campaigns.noise_motion import Command
from service.campaigns.recorder import Recorder, finish, salvage
from service.campaigns.session import SweepEvent, sweep_move
from service.errors import EnvelopeViolation
from service.recording import SweepSpec
from service.store.documents import EventKind, NewRecording, SweepDocument
from service.store.recordings import RecordingFiles, Run
from service.store.store import Store

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


class Station:
    """Where sweeps are run: one at a time, or those of one trajectory at once."""

    def __init__(self, store: Store, files: RecordingFiles, machine: Machine, hub: LiveHub) -> None:
        self._store, self._files, self._machine, self._hub = store, files, machine, hub
        self.check_move: CheckMove | None = None
        """The first way of the check move under way, so that a person can look whether that axis goes that way."""
        # one thread: what is written to a file and what is made of it afterwards never overlap, even when cancelled
        self._disk = ThreadPoolExecutor(1, thread_name_prefix="recorder")

    def close(self) -> None:
        """Wait for the disk."""
        self._disk.shutdown()

    async def run(
        self, sweeps: Sequence[SweepDocument], course: Course, origin: float, checked: set[str]
    ) -> list[SweepDocument]:
        """Run a planned sweep, or the sweeps of one trajectory at once; returns them recorded.

        `origin`: start of the campaign on the monotonic clock, s.

        `checked`: the joints that made their check move in this run of the campaign; those that make it now are added.

        Whatever is raised (also on cancellation): the machine stands, each sweep is failed or interrupted with its
        cause, and what came of samples is kept as a partial recording.
        """
        beginning = asyncio.create_task(asyncio.to_thread(self._begin, sweeps, course))
        cancelled: asyncio.CancelledError | None = None
        try:
            await asyncio.wait([beginning])
        except asyncio.CancelledError as error:  # the store begins it all the same: it has to be ended there as well
            cancelled = error
            await asyncio.wait([beginning])
        together = beginning.result()
        left, recorded = list(together), list[SweepDocument]()
        commands, pose = [each.command for each in together], together[0].sweep.spec.pose
        try:
            if cancelled is not None:
                raise cancelled
            await asyncio.to_thread(course.envelope.check_run, commands, pose)
            await self._approach(together, course, checked)
            started_at = time.monotonic() - origin
            await self._record(together, course)
            here = await self._pose(together[0].sweep, course)  # did the others stand? A brake may have slipped
            moved = {command.joint for command in commands}
            course.envelope.check_standing(pose, here, course.pose_tolerance, moving=moved)
            for each, (spec, recording) in [(each, await self._finish(each, started_at)) for each in together]:
                recorded.append(await self._on_disk(self._end, each.run, SweepEvent.RECORD, "", recording, spec))
                left.remove(each)
        except BaseException as error:
            await asyncio.shield(self._give_up(left, error))
            raise
        for sweep in recorded:
            _log.info("recorded", campaign=sweep.campaign_id, sweep=sweep.number, axis=sweep.spec.axis)
        return recorded

    def _begin(self, sweeps: Sequence[SweepDocument], course: Course) -> list[_Begun]:
        """Begin all of them in the store, or none."""
        together: list[_Begun] = []
        try:
            for planned in sweeps:
                sweep = self._store.begin_sweep(planned.campaign_id, planned.number, sweep_move(SweepEvent.BEGIN))
                run = Run(sweep.campaign_id, sweep.number, sweep.attempt)
                facts: dict[str, JsonValue] = {
                    **asdict(run),
                    "spec": sweep.spec.model_dump(mode="json"),
                    "drives": [asdict(identity) for identity in self._machine.identities],
                }
                together.append(_Begun(sweep, run, course.commands[sweep.number], facts))
        except BaseException as error:
            for each in together:
                self._end(each.run, SweepEvent.FAIL, f"{type(error).__name__}: {error}", None, None)
            raise
        return together

    async def _finish(self, each: _Begun, started_at: float) -> tuple[SweepSpec, NewRecording]:
        """The recording of a sweep that ran, and its spec as measured."""
        port, spec = self._machine.port, each.sweep.spec.model_copy(update={"started_at": started_at})
        streamed = port.set_point_timing
        each.facts["set_point_timing"] = None if streamed is None else asdict(streamed)
        timing = port.channel_timing[each.command.joint]
        return await self._on_disk(finish, self._files, each.run, spec, each.command, timing, each.facts)

    async def _approach(self, together: Sequence[_Begun], course: Course, checked: set[str]) -> None:
        """Bring the axes to the sweeps' pose, one at a time; then check that they are there.

        An axis makes its check move before it goes further than that, and before it is swept.
        """
        sweep, commands = together[0].sweep, [each.command for each in together]
        envelope, pose = course.envelope, sweep.spec.pose
        units = envelope.units()
        here = await self._pose(sweep, course)
        for index, target in await asyncio.to_thread(envelope.order_of_legs, here, pose):
            joint = course.joints[index]
            here = await self._pose(sweep, course)
            if joint not in checked and abs(target - here[index]) > WAY[units[joint]]:
                await self._check(joint, target - here[index], sweep, course)
                checked.add(joint)
                here = await self._pose(sweep, course)
            await asyncio.to_thread(envelope.check_move, joint, here, target, course.move_velocity)
            async with self._energised(joint):
                await self._machine.port.move_to(joint, target, course.move_velocity)
        for command in commands:
            if command.joint not in checked:
                await self._check(command.joint, command.offset_velocity, sweep, course)
                checked.add(command.joint)
        here = await self._pose(sweep, course)
        envelope.check_standing(pose, here, course.pose_tolerance)
        await asyncio.to_thread(envelope.check_run, commands, here)

    async def _check(self, joint: str, towards: float, sweep: SweepDocument, course: Course) -> None:
        """The check move of a joint in the direction of `towards`, and back."""
        units = course.envelope.units()
        way = math.copysign(WAY[units[joint]], towards)
        velocity = min(course.move_velocity, abs(way) / DURATION)
        here = await self._pose(sweep, course)
        start = {each: status.position for each, status in (await self._machine.status()).items()}
        there = CheckMove(joint, way, start, units)
        await asyncio.to_thread(course.envelope.check_move, joint, here, there.target, velocity)
        _log.info("check_move", campaign=sweep.campaign_id, sweep=sweep.number, axis=joint, way=way, unit=units[joint])
        told: dict[str, JsonValue] = {"number": sweep.number, "axis": joint, "way": way, "unit": units[joint]}
        self.check_move = there
        try:
            await asyncio.to_thread(self._store.add_event, sweep.campaign_id, EventKind.CHECK_MOVE, told)
            async with self._energised(joint):
                await make(self._machine, there, velocity)
                reached = {each: status.position for each, status in (await self._machine.status()).items()}
                await make(self._machine, CheckMove(joint, start[joint] - reached[joint], reached, units), velocity)
        finally:
            self.check_move = None

    async def _record(self, together: Sequence[_Begun], course: Course) -> None:
        """Run the sweeps and stream their samples to the disk; SamplesMissing if there are not all of them."""
        recorders: list[Recorder] = []
        try:
            for each in together:
                recorders.append(await self._on_disk(Recorder, self._files.stream(each.run), each.command))
            by_joint = {each.command.joint: (each, own) for each, own in zip(together, recorders, strict=True)}
            async with self._energised(*by_joint), aclosing(self._motion(together)) as blocks:
                async for block in blocks:
                    each, recorder = by_joint.get(block.joint, (together[0], recorders[0]))
                    try:
                        course.envelope.watch(each.command, block)
                        if len(together) > 1 and isinstance(each.command, SweepCommand):
                            start = each.sweep.spec.pose[course.joints.index(block.joint)]
                            course.envelope.watch_path(each.command, start, block)
                    except EnvelopeViolation:
                        await self._machine.port.stop()  # before the evidence is written
                        await self._on_disk(recorder.write, block)
                        raise
                    self._hub.publish(each.run.campaign_id, each.run.number, block)
                    await self._on_disk(recorder.write, block)
            for recorder in recorders:
                recorder.check_complete()
        finally:
            for recorder in recorders:
                await asyncio.shield(self._on_disk(recorder.close))

    def _motion(self, together: Sequence[_Begun]) -> AsyncGenerator[SampleBlock, None]:
        """What the drives do; nothing moves before it is iterated."""
        port, first = self._machine.port, together[0].command
        if isinstance(first, NoiseCommand):
            return port.run_noise(first)
        return port.run_sweep(*(each.command for each in together if isinstance(each.command, SweepCommand)))

    @asynccontextmanager
    async def _energised(self, *joints: str) -> AsyncGenerator[None]:
        """Axes with energy. After an error it is `_give_up` that takes the energy away, with the stop ladder."""
        self._machine.check_may_move()
        await self._machine.port.enable(*joints)
        self._machine.check_may_move()  # a stop may have come while the drives were being enabled
        yield
        for joint in joints:
            await self._machine.port.disable(joint)

    async def _pose(self, sweep: SweepDocument, course: Course) -> tuple[float, ...]:
        """Where the axes stand; those that this machine does not reach are taken to be where the plan says.

        CommunicationLost where a drive does not answer: what its axis does is not known then.
        """
        status = await self._machine.status()
        for joint, axis in status.items():
            if axis.state is AxisState.UNKNOWN:
                raise CommunicationLost(f"{joint}: its drive does not answer")
        return tuple(
            status[joint].position if joint in status else planned
            for joint, planned in zip(course.joints, sweep.spec.pose, strict=True)
        )

    async def _give_up(self, left: Sequence[_Begun], error: BaseException) -> None:
        cause = cause_of(self._machine, error)
        interrupted = bool(self._machine.held) or isinstance(error, SweepInterrupted | asyncio.CancelledError)
        try:
            await self._machine.port.stop()
        except DriveError as unconfirmed:
            cause = f"{cause}; the stop is not confirmed: {unconfirmed}"
            self._machine.lost(str(unconfirmed))
        if isinstance(error, CommunicationLost):
            self._machine.lost(str(error))
        event = SweepEvent.INTERRUPT if interrupted else SweepEvent.FAIL
        for each in left:
            await self._abandon(each, event, cause)

    async def _abandon(self, each: _Begun, event: SweepEvent, cause: str) -> None:
        """Keep what came of a sweep's samples, and end it in the store."""
        run = each.run
        _log.error("sweep_given_up", campaign=run.campaign_id, sweep=run.number, cause=cause)
        try:
            recording = await self._on_disk(salvage, self._files, run, {**each.facts, "cause": cause})
        except OSError as full:  # the stream stays; the next start makes a recording of it
            cause, recording = f"{cause}; partial recording not written: {full}", None
        await self._on_disk(self._end, run, event, cause, recording, None)

    def _end(
        self, run: Run, event: SweepEvent, cause: str, recording: NewRecording | None, spec: SweepSpec | None
    ) -> SweepDocument:
        """The end of a run in the store; the stream goes once its recording's row is there."""
        move = sweep_move(event)
        sweep = self._store.end_sweep(run.campaign_id, run.number, move, cause, spec, recording)
        if recording is not None:
            self._files.stream(run).unlink()
        return sweep

    async def _on_disk(
        self, work: Callable[Arguments, Result], *args: Arguments.args, **kwargs: Arguments.kwargs
    ) -> Result:
        return await asyncio.get_running_loop().run_in_executor(self._disk, partial(work, *args, **kwargs))


def cause_of(machine: Machine, error: BaseException) -> str:
    """What a person is told: who stopped the machine, or what went wrong."""
    if machine.held:
        return machine.held
    if isinstance(error, asyncio.CancelledError):
        return str(error) or "cancelled"
    return f"{type(error).__name__}: {error}"
