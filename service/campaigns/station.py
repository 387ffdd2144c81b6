"""Runs one sweep at the machine: to the pose, energy on, sweep, energy off, recording. Any error: stand still first."""

import asyncio
import math
import time
from collections.abc import AsyncGenerator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import aclosing, asynccontextmanager
from dataclasses import asdict
from functools import partial
from typing import ParamSpec, TypeVar

import structlog
from pydantic import JsonValue

from drivers.errors import CommunicationLost, DriveError, SweepInterrupted
from drivers.ports import AxisState, SweepCommand
from service.campaigns.check_move import DURATION, WAY, CheckMove, make
from service.campaigns.course import Course
from service.campaigns.live import LiveHub
from service.campaigns.machine import Machine
from service.campaigns.recorder import Facts, Recorder, finish, salvage
from service.campaigns.session import SweepEvent, sweep_move
from service.errors import EnvelopeViolation
from service.recording import SweepSpec
from service.store.documents import EventKind, NewRecording, SweepDocument
from service.store.recordings import RecordingFiles, Run
from service.store.store import Store

_log = structlog.get_logger(__name__)

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class Station:
    """Where sweeps are run, one at a time."""

    def __init__(self, store: Store, files: RecordingFiles, machine: Machine, hub: LiveHub) -> None:
        self._store, self._files, self._machine, self._hub = store, files, machine, hub
        # one thread: what is written to a file and what is made of it afterwards never overlap, even when cancelled
        self._disk = ThreadPoolExecutor(1, thread_name_prefix="recorder")

    def close(self) -> None:
        """Wait for the disk."""
        self._disk.shutdown()

    async def run(self, sweep: SweepDocument, course: Course, origin: float, checked: set[str]) -> SweepDocument:
        """Run a planned sweep; returns it recorded. `origin`: start of the campaign on the monotonic clock, s.

        `checked`: the joints that made their check move in this run of the campaign; those that make it now are added.

        Whatever is raised (also on cancellation): the machine stands, the sweep is failed or interrupted with its
        cause, and what came of samples is kept as a partial recording.
        """
        begun = asyncio.create_task(
            asyncio.to_thread(self._store.begin_sweep, sweep.campaign_id, sweep.number, sweep_move(SweepEvent.BEGIN))
        )
        cancelled: asyncio.CancelledError | None = None
        try:
            await asyncio.wait([begun])
        except asyncio.CancelledError as error:  # the store begins it all the same: it has to be ended there as well
            cancelled = error
            await asyncio.wait([begun])
        sweep = begun.result()
        run = Run(sweep.campaign_id, sweep.number, sweep.attempt)
        command = course.commands[sweep.number]
        facts: dict[str, JsonValue] = {
            **asdict(run),
            "spec": sweep.spec.model_dump(mode="json"),
            "drives": [asdict(identity) for identity in self._machine.identities],
        }
        try:
            if cancelled is not None:
                raise cancelled
            await asyncio.to_thread(course.envelope.check_sweep, command, sweep.spec.pose)
            await self._approach(sweep, course, checked)
            started_at = time.monotonic() - origin
            await self._record(run, command, course)
            here = await self._pose(sweep, course)  # did the others stand? A brake may have slipped
            course.envelope.check_standing(sweep.spec.pose, here, course.pose_tolerance, moving=command.joint)
            spec = sweep.spec.model_copy(update={"started_at": started_at})
            streamed = self._machine.port.set_point_timing
            facts["set_point_timing"] = None if streamed is None else asdict(streamed)
            timing = self._machine.port.channel_timing[command.joint]
            spec, recording = await self._on_disk(finish, self._files, run, spec, command, timing, facts)
            sweep = await self._on_disk(self._end, run, SweepEvent.RECORD, "", recording, spec)
        except BaseException as error:
            await asyncio.shield(self._give_up(run, facts, error))
            raise
        _log.info("recorded", campaign=run.campaign_id, sweep=run.number, axis=command.joint)
        return sweep

    async def _approach(self, sweep: SweepDocument, course: Course, checked: set[str]) -> None:
        """Bring the axes to the sweep's pose, one at a time; then check that they are there.

        An axis makes its check move before it goes further than that, and before it is swept.
        """
        envelope, pose, command = course.envelope, sweep.spec.pose, course.commands[sweep.number]
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
        if command.joint not in checked:
            await self._check(command.joint, command.offset_velocity, sweep, course)
            checked.add(command.joint)
        here = await self._pose(sweep, course)
        envelope.check_standing(pose, here, course.pose_tolerance)
        await asyncio.to_thread(envelope.check_sweep, command, here)

    async def _check(self, joint: str, towards: float, sweep: SweepDocument, course: Course) -> None:
        """The check move of a joint in the direction of `towards`, and back."""
        units = course.envelope.units()
        way = math.copysign(WAY[units[joint]], towards)
        velocity = min(course.move_velocity, abs(way) / DURATION)
        here = await self._pose(sweep, course)
        start = {each: status.position for each, status in (await self._machine.status()).items()}
        there = start[joint] + way
        await asyncio.to_thread(course.envelope.check_move, joint, here, there, velocity)
        _log.info("check_move", campaign=sweep.campaign_id, sweep=sweep.number, axis=joint, way=way, unit=units[joint])
        told: dict[str, JsonValue] = {"number": sweep.number, "axis": joint, "way": way, "unit": units[joint]}
        await asyncio.to_thread(self._store.add_event, sweep.campaign_id, EventKind.CHECK_MOVE, told)
        async with self._energised(joint):
            await make(self._machine, CheckMove(joint, way, start, units), velocity)
            reached = {each: status.position for each, status in (await self._machine.status()).items()}
            await make(self._machine, CheckMove(joint, start[joint] - reached[joint], reached, units), velocity)

    async def _record(self, run: Run, command: SweepCommand, course: Course) -> None:
        """Run the sweep and stream its samples to the disk; SamplesMissing if there are not all of them."""
        recorder = await self._on_disk(Recorder, self._files.stream(run), command)
        try:
            async with self._energised(command.joint), aclosing(self._machine.port.run_sweep(command)) as blocks:
                async for block in blocks:
                    try:
                        course.envelope.watch(command, block)
                    except EnvelopeViolation:
                        await self._machine.port.stop()  # before the evidence is written
                        await self._on_disk(recorder.write, block)
                        raise
                    self._hub.publish(run.campaign_id, run.number, block)
                    await self._on_disk(recorder.write, block)
            recorder.check_complete()
        finally:
            await asyncio.shield(self._on_disk(recorder.close))

    @asynccontextmanager
    async def _energised(self, joint: str) -> AsyncGenerator[None]:
        """One axis with energy. After an error it is `_give_up` that takes the energy away, with the stop ladder."""
        self._machine.check_may_move()
        await self._machine.port.enable(joint)
        self._machine.check_may_move()  # a stop may have come while the drive was being enabled
        yield
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

    async def _give_up(self, run: Run, facts: Facts, error: BaseException) -> None:
        cause = cause_of(self._machine, error)
        interrupted = bool(self._machine.held) or isinstance(error, SweepInterrupted | asyncio.CancelledError)
        try:
            await self._machine.port.stop()
        except DriveError as unconfirmed:
            cause = f"{cause}; the stop is not confirmed: {unconfirmed}"
            self._machine.lost(str(unconfirmed))
        if isinstance(error, CommunicationLost):
            self._machine.lost(str(error))
        _log.error("sweep_given_up", campaign=run.campaign_id, sweep=run.number, cause=cause)
        try:
            recording = await self._on_disk(salvage, self._files, run, {**facts, "cause": cause})
        except OSError as full:  # the stream stays; the next start makes a recording of it
            cause, recording = f"{cause}; partial recording not written: {full}", None
        event = SweepEvent.INTERRUPT if interrupted else SweepEvent.FAIL
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
