"""A `DrivePort` over CiA 402 axes on any fieldbus: which motion is allowed, and how all axes are stopped."""

import asyncio
import itertools
import logging
import threading
from collections.abc import AsyncGenerator, Callable, Collection, Coroutine, Generator, Mapping, Sequence
from contextlib import aclosing, contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, TypeVar

from drivers.cia402 import checks, states
from drivers.cia402.axis import Cia402Axis, Energy
from drivers.cia402.connection import DriveConnection, DriveThread, Fieldbus, RunningSweep
from drivers.cia402.motions import DriveSweep, bring_down, move
from drivers.cia402.profile import AxisProfile
from drivers.errors import Cause, DriveError, LimitExceeded, NotReady, StopNotConfirmed, SweepInterrupted
from drivers.ports import (
    AxisIdentity,
    AxisStatus,
    BusTraffic,
    Capabilities,
    ChannelTiming,
    Fault,
    NoiseCommand,
    ReportsTraffic,
    SampleBlock,
    SetPointTiming,
    StopSender,
    SweepCommand,
    SweepMode,
)

logger = logging.getLogger(__name__)

Command = SweepCommand | NoiseCommand
Result = TypeVar("Result")


@dataclass(slots=True, eq=False)
class MotionUnderWay:
    """The motion in progress, and its run if it is a sweep."""

    axes: tuple[Cia402Axis, ...]
    stop: threading.Event = field(default_factory=threading.Event)
    run: RunningSweep | None = None


class Cia402Machine:
    """See `drivers.ports.DrivePort`. One instance per event loop; not connected until `connect`."""

    def __init__(self, profiles: Sequence[AxisProfile], fieldbus: Fieldbus) -> None:
        self._profiles = tuple(profiles)
        self._fieldbus = fieldbus
        self._link: DriveConnection | None = None
        self._motion: MotionUnderWay | None = None
        self._enabling: list[MotionUnderWay] = []  # of axes that still stand
        self._cleanups: set[asyncio.Task[Any]] = set()
        self._closing: asyncio.Task[None] | None = None
        self._reading = asyncio.Lock()  # one status at a time in the thread's queue: a stop must not wait for many
        self._last_run: RunningSweep | None = None
        self._watched = False  # by a caller, who is told
        self._looking: asyncio.Task[None] | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        return tuple(profile.joint for profile in self._profiles)

    @property
    def channel_timing(self) -> Mapping[str, ChannelTiming]:
        return {profile.joint: profile.channels.timing for profile in self._profiles}

    @property
    def capabilities(self) -> Capabilities:
        """Raises NotReady before `connect`."""
        return self._connected().capabilities

    @property
    def set_point_timing(self) -> SetPointTiming | None:
        return None if self._last_run is None else self._last_run.timing()

    @property
    def bus_traffic(self) -> BusTraffic | None:
        return self._link.bus_traffic if isinstance(self._link, ReportsTraffic) else None

    # -- connection ----------------------------------------------------------------------------------------------

    async def connect(self) -> tuple[AxisIdentity, ...]:
        await self._closed()
        if self._link is not None:
            raise NotReady("already connected")
        self._link = link = await self._fieldbus.open()
        self._fieldbus.watch.keep(True)
        self._looking = asyncio.create_task(look(link, self._reading, self._idle), name="look at the axes")
        return link.identities

    async def close(self) -> None:
        if self._link is not None and self._closing is None:
            self._closing = asyncio.create_task(self._close(self._link), name="close the connection")
        await self._closed()

    async def _close(self, link: DriveConnection) -> None:
        """Runs once and to its end, even if the caller is cancelled: on a half-closed bus our heartbeat would continue,
        and the drives would keep their energy.
        """
        axes = self._moving_first(link)
        try:
            await self._interrupt()
            if self._motion is not None and self._motion.run is not None:
                await self._motion.run.over()
            if self._cleanups:
                await asyncio.wait(tuple(self._cleanups))  # their callers get their errors
            self._link = None
            for axis in axes:
                try:
                    await link.thread.run(axis.device.reopen)
                    await bring_down(link.thread, axis)
                except DriveError as error:
                    logger.error("while closing: %s", error)
        finally:
            self._link = None
            try:
                if self._looking is not None:
                    self._looking.cancel()
                    await asyncio.gather(self._looking, return_exceptions=True)
                await link.close()
                self._fieldbus.watch.keep(self._watched)
            finally:
                self._closing = None

    async def _closed(self) -> None:
        """Wait until a closing in progress is finished."""
        if self._closing is not None:
            await asyncio.shield(self._closing)

    def watch(self, tell: Callable[[Cause], None] | None) -> None:
        self._watched = tell is not None
        self._fieldbus.watch.tell_to(tell)
        self._fieldbus.watch.keep(self._watched or self._link is not None)

    def allow(self) -> None:
        self._fieldbus.watch.allow()

    # -- state ---------------------------------------------------------------------------------------------------

    async def status(self) -> Mapping[str, AxisStatus]:
        async with self._reading:
            link = self._connected()
            return {joint: await link.thread.run(axis.status) for joint, axis in link.axes.items()}

    async def faults(self) -> tuple[Fault, ...]:
        return tuple(status.fault for status in (await self.status()).values() if status.fault is not None)

    async def acknowledge(self, joint: str) -> None:
        axis = self._axis(joint)
        await self._connected().thread.run(axis.acknowledge)

    async def enable(self, *joints: str) -> None:
        enabling = MotionUnderWay(tuple(self._axis(joint) for joint in joints))
        link = self._connected()
        self._enabling.append(enabling)
        try:
            await link.thread.run(enable_alone, enabling.axes, tuple(link.axes.values()), enabling.stop)
        except asyncio.CancelledError:  # the call continues in its thread and may still enable an axis
            await self._shield(self._abandon(enabling))
            raise
        finally:
            self._enabling.remove(enabling)

    async def disable(self, joint: str) -> None:
        axis = self._axis(joint)
        if any(axis in each.axes for each in (self._motion, *self._enabling) if each is not None):
            await self._interrupt()
        await self._shield(bring_down(self._connected().thread, axis))

    def halt(self) -> None:
        link, motion = self._link, self._motion
        self._fieldbus.watch.look()  # report a gap as such, and not its consequences
        for each in (*self._enabling, *(() if motion is None else (motion,))):
            each.stop.set()
        if link is not None:
            for axis in link.axes.values():  # an axis enabled in this moment has been asked to stop by now
                axis.expect_stop()
        run = None if motion is None else motion.run
        if run is not None:
            run.halt()
        if link is not None:
            link.halt(streaming=run is not None and run.streams)

    async def stop(self) -> tuple[str, ...]:
        self.halt()
        if self._link is not None:
            return await self._shield(self._stop(self._link))
        await self._closed()  # which brings every axis down as well
        return ()

    def stop_sender(self) -> StopSender:
        return self._fieldbus.stop_sender()

    async def _stop(self, link: DriveConnection) -> tuple[str, ...]:
        """Stop every axis, the moving ones first; `halt` was already sent to all."""
        axes = self._moving_first(link)
        await self._interrupt()
        for axis in axes:
            with suppress(DriveError):  # the stop sequence reports it
                await link.thread.run(axis.device.reopen)
        await self._bring_down(link, axes)
        return self.joints

    # -- motion --------------------------------------------------------------------------------------------------

    async def move_to(self, joint: str, position: float, velocity: float) -> None:
        axis = self._axis(joint)
        link = self._connected()
        checks.check_move(axis.profile, position, velocity)
        with self._moving((axis,)) as motion:
            try:
                await move(link.thread, axis, position, velocity, motion.stop, _others(link, motion))
            except BaseException:
                await self._shield(self._abandon(motion))
                raise

    async def run_sweep(self, *commands: SweepCommand) -> AsyncGenerator[SampleBlock, None]:
        axes = tuple(self._axis(command.joint) for command in commands)
        _check_together(axes, commands, self._connected().capabilities)
        async with aclosing(self._run(axes, commands)) as blocks:
            async for block in blocks:
                yield block

    async def run_noise(self, command: NoiseCommand) -> AsyncGenerator[SampleBlock, None]:
        axis = self._axis(command.joint)
        if not self._connected().capabilities.torque_injection:
            raise NotReady(axis.place, "torque noise is not supported by this drive")
        async with aclosing(self._run((axis,), (command,))) as blocks:
            async for block in blocks:
                yield block

    async def _run(
        self, axes: tuple[Cia402Axis, ...], commands: Sequence[Command]
    ) -> AsyncGenerator[SampleBlock, None]:
        link = self._connected()
        with self._moving(axes) as motion:
            for axis, command in zip(axes, commands, strict=True):
                start = await link.thread.run(axis.require_enabled)
                if isinstance(command, NoiseCommand):
                    checks.check_noise(axis.profile, command, start.position)
                else:
                    checks.check_sweep(axis.profile, command, start.position, link.sync_period)
            completed = False
            try:
                run = await self._start(link, commands, motion)
                async with Watched(link.thread, _others(link, motion), motion.stop), aclosing(run.blocks()) as blocks:
                    async for block in blocks:
                        yield block
                completed = True
            finally:
                if not completed:
                    await self._shield(self._abandon(motion))

    async def _start(self, link: DriveConnection, commands: Sequence[Command], motion: MotionUnderWay) -> RunningSweep:
        envelopes = [
            checks.sweep_envelope(axis.profile, command) for axis, command in zip(motion.axes, commands, strict=True)
        ]
        for axis, envelope in zip(motion.axes, envelopes, strict=True):
            await link.thread.run(axis.device.read_back)
            limits = (envelope.velocity_limit, envelope.effort_limit, envelope.window)
            await link.thread.run(axis.device.settle_limits, *limits)
        streamed = [
            (command, envelope)
            for command, envelope in zip(commands, envelopes, strict=True)
            if isinstance(command, SweepCommand) and command.mode is SweepMode.HOST_STREAMED
        ]
        if streamed:
            motion.run = await link.stream(streamed, motion.stop)
        else:
            (axis,), (command,), (envelope,) = motion.axes, commands, envelopes
            motion.run = DriveSweep(
                link.thread, axis, command, envelope, motion.stop, lambda: bring_down(link.thread, axis)
            )
        self._last_run = motion.run
        return motion.run

    @contextmanager
    def _moving(self, axes: tuple[Cia402Axis, ...]) -> Generator[MotionUnderWay]:
        if self._motion is not None or self._cleanups:
            other = self._motion.axes[0].place if self._motion else "an axis"
            raise NotReady(axes[0].place, f"{other} is under way; one motion at a time")
        self._motion = motion = MotionUnderWay(axes)
        try:
            yield motion
        finally:
            self._motion = None

    def _moving_first(self, link: DriveConnection) -> list[Cia402Axis]:
        """Then those with energy: each silent axis costs a time-out, which must not delay the others."""
        moving = () if self._motion is None else self._motion.axes
        return sorted(link.axes.values(), key=lambda axis: (axis not in moving, axis.energy is Energy.OFF))

    async def _interrupt(self) -> None:
        """Ask the motion in progress to stop, and wait until the stop sequence may talk to its drives."""
        for enabling in self._enabling:  # it occupies the thread on which the stop sequence runs
            enabling.stop.set()
        motion = self._motion
        if motion is None:
            return
        motion.stop.set()
        if motion.run is not None:
            await motion.run.interrupted()

    async def _abandon(self, motion: MotionUnderWay) -> None:
        """After any early end: finish the run, stop and de-energise its axes. Errors are logged and not raised, so that
        they do not hide what ended the motion.
        """
        motion.stop.set()
        if motion.run is not None:
            await motion.run.over()  # its error was raised to the consumer
        if self._link is None:
            return  # closed meanwhile, which brought the axes down
        try:
            await self._bring_down(self._link, motion.axes)
        except DriveError as error:
            logger.error("stop sequence: %s", error)

    async def _bring_down(self, link: DriveConnection, axes: Sequence[Cia402Axis]) -> None:
        trouble: dict[str, str] = {}
        for axis in axes:
            try:
                await bring_down(link.thread, axis)
            except DriveError as error:  # the others must be stopped all the same
                trouble[axis.profile.joint] = str(error)
        if trouble:
            down = [axis.profile.joint for axis in axes if axis.profile.joint not in trouble]
            raise StopNotConfirmed(down, trouble)

    async def _shield(self, work: Coroutine[object, object, Result]) -> Result:
        """Runs `work` to its end even if the caller is cancelled."""
        task = asyncio.create_task(work, name="bring down")
        self._cleanups.add(task)
        task.add_done_callback(self._cleanups.discard)
        return await asyncio.shield(task)

    def _connected(self) -> DriveConnection:
        if self._link is None:
            raise NotReady("not connected")
        return self._link

    def _idle(self) -> bool:
        return self._motion is None and not self._enabling and not self._cleanups

    def _axis(self, joint: str) -> Cia402Axis:
        axes = self._connected().axes
        if joint not in axes:
            raise NotReady(joint, f"unknown joint; the machine has {', '.join(axes)}")
        return axes[joint]


def _others(link: DriveConnection, motion: MotionUnderWay) -> tuple[Cia402Axis, ...]:
    """The axes that stand during the motion: an error of one of them also ends the motion."""
    return tuple(axis for axis in link.axes.values() if axis not in motion.axes)


def _check_together(axes: tuple[Cia402Axis, ...], commands: Sequence[SweepCommand], can: Capabilities) -> None:
    """Raises NotReady if this machine cannot run these sweeps, LimitExceeded if they cannot run together."""
    if not commands:
        raise LimitExceeded("a sweep needs at least one axis")
    first = commands[0]
    if first.mode not in can.sweep_modes:
        raise NotReady(axes[0].place, f"sweeps of mode '{first.mode.value}' are not supported by this drive")
    most = can.simultaneous_axes if first.mode is SweepMode.HOST_STREAMED else 1
    if len(commands) > most:
        raise NotReady(f"{len(commands)} axes at once: this machine moves at most {most} in mode '{first.mode.value}'")
    if len(set(axes)) < len(axes):
        raise LimitExceeded("sweeps of several axes at once: an axis is listed twice")
    times = {(c.mode, c.ramp, c.settle, c.period, c.periods) for c in commands}
    if len(times) > 1:
        raise LimitExceeded("sweeps of several axes at once must have the same mode, ramp, settle, period and periods")


def enable_alone(axes: Collection[Cia402Axis], all_axes: Collection[Cia402Axis], stop: threading.Event) -> None:
    """Enables `axes`; if one cannot be enabled, all of them are left disabled. Blocking.

    The others are checked before and after: of two hosts that enable different axes at once, each energises its own
    before it looks at the other's, so at least one sees the other's and takes its own back before it moves.
    """
    _require_alone(axes, all_axes)
    try:
        for axis in axes:
            axis.enable(stop)
        _require_alone(axes, all_axes)
    except BaseException:
        for axis in (each for each in axes if each.energy is not Energy.OFF):  # the others may be another host's
            try:
                axis.disable()
            except DriveError as error:  # the others must be disabled all the same
                logger.error("after enabling failed: %s", error)
        raise


def _require_alone(axes: Collection[Cia402Axis], all_axes: Collection[Cia402Axis]) -> None:
    """Raises NotReady if another axis has energy."""
    for other in all_axes:
        state = other.state()
        other.check(state)
        if other not in axes and state in states.ENERGISED:
            place = next(iter(axes)).place
            raise NotReady(place, f"{other.place} is '{state.value}'; it must be disabled first")


class Watched:
    """Runs a sweep inside the block: an error of a standing axis sets `stop` and is raised instead of the interruption.

    Not a generator: the end of an event loop closes generators in any order.
    """

    def __init__(self, thread: DriveThread, standing: Sequence[Cia402Axis], stop: threading.Event) -> None:
        self._work = thread, standing, stop

    async def __aenter__(self) -> None:
        self._watch = asyncio.create_task(_watch(*self._work), name="standing axes")

    async def __aexit__(self, _: object, error: BaseException | None, __: object) -> None:
        over = self._watch.done() and not self._watch.cancelled()
        found = self._watch.exception() if over else None
        self._watch.cancel()
        await asyncio.gather(self._watch, return_exceptions=True)
        if found is not None and isinstance(error, SweepInterrupted):
            raise found


async def _watch(thread: DriveThread, standing: Sequence[Cia402Axis], stop: threading.Event) -> None:
    """Runs until `stop` is set. During the stop sequence the standing axes receive commands too."""
    try:
        while not stop.is_set():
            await thread.run(_check, standing)
            await asyncio.sleep(0.02)
    except Exception:  # nobody watches any more
        stop.set()
        raise


def _check(standing: Sequence[Cia402Axis]) -> None:
    for axis in standing:
        axis.check_standing()


async def look(link: DriveConnection, reading: asyncio.Lock, idle: Callable[[], bool]) -> None:
    """Checks one axis after the other whether another host enabled it, until cancelled.

    `reading`: lock held while the axes are polled; `idle`: True if no motion is in progress.
    """
    for axis in itertools.cycle(link.axes.values()):
        await asyncio.sleep(0.3)
        async with reading:
            if idle():
                with suppress(DriveError):  # the next caller gets the error
                    await link.thread.run(axis.check_unused)
