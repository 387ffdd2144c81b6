"""The CANopen adapter: a `drivers.ports.DrivePort` of one bus with a CiA 402 node an axis."""

import asyncio
import hashlib
import logging
import threading
from collections.abc import AsyncGenerator, Coroutine, Generator, Iterable, Mapping
from contextlib import aclosing, contextmanager, suppress
from dataclasses import dataclass, field

from drivers.canopen import frames, objects
from drivers.canopen.axis import Axis
from drivers.canopen.bus import Bus
from drivers.canopen.drive_sweep import DriveSweep
from drivers.canopen.host_sweep import Ending, HostSweep, Timing
from drivers.canopen.objects import Entry
from drivers.canopen.positioning import move
from drivers.canopen.profile import CanopenProfile
from drivers.canopen.sdo_thread import SdoThread
from drivers.canopen.stopping import bring_down
from drivers.cia402 import checks, states
from drivers.errors import CommunicationLost, DriveError, EnvelopeLeft, NotReady, SweepInterrupted
from drivers.ports import AxisIdentity, AxisStatus, Capabilities, Fault, SampleBlock, SweepCommand, SweepMode

logger = logging.getLogger(__name__)


@dataclass(slots=True)
class Motion:
    """The one motion under way, and what runs it if it is a sweep."""

    joint: str
    stop: threading.Event = field(default_factory=threading.Event)
    run: HostSweep | DriveSweep | None = None


@dataclass(frozen=True, slots=True)
class Link:
    """What exists while connected."""

    sdo: SdoThread
    opening: asyncio.Task[Bus]
    bus: Bus
    heart: asyncio.Task[None]
    axes: Mapping[str, Axis]
    capabilities: Capabilities


class CanopenMachine:
    """See `drivers.ports.DrivePort`. One instance, one event loop; not connected until `connect`."""

    def __init__(self, profile: CanopenProfile) -> None:
        self._profile = profile
        self._link: Link | None = None
        self._motion: Motion | None = None
        self._cleanups: set[asyncio.Task[None]] = set()
        self._reading = asyncio.Lock()  # one status at a time in the SDO thread's queue: a stop must not wait for many
        self.timing: Timing | None = None
        """How punctual the last host-streamed sweep was."""

    @property
    def joints(self) -> tuple[str, ...]:
        return tuple(axis.joint for axis in self._profile.axes)

    @property
    def capabilities(self) -> Capabilities:
        """NotReady before `connect`."""
        return self._connected().capabilities

    # -- connection ----------------------------------------------------------------------------------------------

    async def connect(self) -> tuple[AxisIdentity, ...]:
        if self._link is not None:
            raise NotReady("already connected")
        sdo = SdoThread()
        nodes = tuple(axis.node for axis in self._profile.axes)
        opening = asyncio.create_task(sdo.run(Bus, self._profile.bus, nodes))
        heart: asyncio.Task[None] | None = None
        try:
            bus = await asyncio.shield(opening)
            heart = asyncio.create_task(self._beat(bus), name="can-heartbeat")
            axes, identities = await sdo.run(_introduce, self._profile, bus)
        except BaseException:
            await self._shield(_release(sdo, opening, heart))
            raise
        self._link = Link(sdo, opening, bus, heart, axes, _capabilities(axes.values()))
        return identities

    async def close(self) -> None:
        if self._link is None:
            return
        await self._interrupt()
        if self._motion is not None and self._motion.run is not None:
            await self._motion.run.over()
        for task in tuple(self._cleanups):
            await task
        link, self._link = self._link, None
        for axis in link.axes.values():
            try:
                await bring_down(link.sdo, axis)
            except DriveError as error:
                logger.error("while closing: %s", error)
        await self._shield(_release(link.sdo, link.opening, link.heart))

    async def _beat(self, bus: Bus) -> None:
        """Our heartbeat, from the event loop on purpose: a host that hangs falls silent, and the drives stop."""
        settings = self._profile.bus
        with suppress(CommunicationLost):  # the bus keeps the reason; whoever uses it next gets it
            while True:
                bus.check_alive()
                bus.send(frames.HEARTBEAT + settings.host_node, bytes([frames.OPERATIONAL]))
                await asyncio.sleep(settings.host_heartbeat)

    # -- state ---------------------------------------------------------------------------------------------------

    async def status(self) -> Mapping[str, AxisStatus]:
        async with self._reading:
            link = self._connected()
            return {joint: await link.sdo.run(axis.status) for joint, axis in link.axes.items()}

    async def faults(self) -> tuple[Fault, ...]:
        return tuple(status.fault for status in (await self.status()).values() if status.fault is not None)

    async def acknowledge(self, joint: str) -> None:
        axis = self._axis(joint)
        await self._connected().sdo.run(axis.acknowledge)

    async def enable(self, joint: str) -> None:
        axis = self._axis(joint)
        link = self._connected()
        try:
            await link.sdo.run(_enable_alone, axis, tuple(link.axes.values()))
        except asyncio.CancelledError:  # the call goes on without us, and what it enables nobody would know of
            await self._shield(bring_down(link.sdo, axis))
            raise

    async def disable(self, joint: str) -> None:
        axis = self._axis(joint)
        if self._motion is not None and self._motion.joint == joint:
            await self._interrupt()
        await self._shield(bring_down(self._connected().sdo, axis))

    async def stop(self) -> None:
        if self._link is not None:
            await self._shield(self._stop(self._link))

    async def _stop(self, link: Link) -> None:
        """Every axis down, the moving one first."""
        moving = "" if self._motion is None else self._motion.joint
        await self._interrupt()
        trouble: DriveError | None = None
        for axis in sorted(link.axes.values(), key=lambda axis: axis.profile.joint != moving):
            try:
                await bring_down(link.sdo, axis)
            except DriveError as error:  # the others must be stopped all the same
                trouble = trouble or error
        if trouble is not None:
            raise trouble

    # -- motion --------------------------------------------------------------------------------------------------

    async def move_to(self, joint: str, position: float, velocity: float) -> None:
        axis = self._axis(joint)
        link = self._connected()
        checks.check_move(axis.profile, position, velocity)
        with self._moving(axis) as motion:
            try:
                await move(link.sdo, axis, position, velocity, motion.stop)
            except BaseException:
                await self._shield(self._abandon(axis, motion))
                raise

    async def run_sweep(self, command: SweepCommand) -> AsyncGenerator[SampleBlock, None]:
        axis = self._axis(command.joint)
        link = self._connected()
        if command.mode not in link.capabilities.sweep_modes:
            raise NotReady(f"{axis.place}: sweeps of mode '{command.mode.value}' are not supported by this drive")
        with self._moving(axis) as motion:
            start = await link.sdo.run(axis.require_enabled)
            checks.check_sweep(axis.profile, command, start.position, self._profile.bus.sync_period)
            completed = False
            try:
                run = await self._start(link, axis, command, motion)
                async with aclosing(run.blocks()) as blocks:
                    async for block in blocks:
                        yield block
                if isinstance(run, HostSweep):
                    await self._conclude(link.sdo, axis, run)
                completed = True
            finally:
                if not completed:
                    await self._shield(self._abandon(axis, motion))

    async def _start(self, link: Link, axis: Axis, command: SweepCommand, motion: Motion) -> HostSweep | DriveSweep:
        envelope = checks.sweep_envelope(axis.profile, command)
        await link.sdo.run(axis.read_back)
        await link.sdo.run(axis.settle_limits, envelope.velocity_limit, envelope.effort_limit, envelope.window)
        if command.mode is SweepMode.DRIVE_SIDE:
            run = DriveSweep(link.sdo, axis, command, envelope, motion.stop, lambda: bring_down(link.sdo, axis))
        else:
            counter = await link.sdo.run(axis.prepare_streaming)
            settings = self._profile.bus
            run = HostSweep(link.bus, axis.profile, settings, axis.codec, command, envelope, counter, motion.stop)
            self.timing = run.timing
        motion.run = run
        return run

    async def _conclude(self, sdo: SdoThread, axis: Axis, run: HostSweep) -> None:
        """Leave the cyclic mode while SYNC still runs, or raise what ended the sweep."""
        if run.ending is Ending.COMPLETED:
            await sdo.run(axis.set_mode, objects.PROFILE_POSITION)
            run.release()
        await run.finished()
        match run.ending:
            case Ending.COMPLETED:
                return
            case Ending.STOPPED:
                raise SweepInterrupted(f"{axis.place}: sweep was stopped")
            case Ending.SILENT:
                raise CommunicationLost(f"{axis.place}: {run.reason}")
            case Ending.LEFT_STATE:
                await sdo.run(axis.check, await sdo.run(axis.state))
                raise SweepInterrupted(f"{axis.place}: {run.reason}")
            case Ending.LEFT_ENVELOPE | Ending.NO_STANDSTILL:
                raise EnvelopeLeft(f"{axis.place}: {run.reason or run.ending.value}")

    @contextmanager
    def _moving(self, axis: Axis) -> Generator[Motion]:
        if self._motion is not None or self._cleanups:
            other = self._motion.joint if self._motion else "an axis"
            raise NotReady(f"{axis.place}: {other} is under way; one motion at a time")
        self._motion = motion = Motion(axis.profile.joint)
        try:
            yield motion
        finally:
            self._motion = None

    async def _interrupt(self) -> None:
        """Ask the motion under way to stop; for a streamed sweep wait until its own ladder is done."""
        motion = self._motion
        if motion is None:
            return
        motion.stop.set()
        if isinstance(motion.run, HostSweep):
            await motion.run.over()

    async def _abandon(self, axis: Axis, motion: Motion) -> None:
        """After any early end: the run over, the axis at standstill and de-energised. Trouble is logged, not raised,
        so that it does not hide what ended the motion."""
        motion.stop.set()
        if motion.run is not None:
            await motion.run.over()  # its trouble was given to the consumer
        if self._link is None:
            return  # closed meanwhile, which brought the axis down
        try:
            await bring_down(self._link.sdo, axis)
        except DriveError as error:
            logger.error("stop ladder: %s", error)

    async def _shield(self, work: Coroutine[object, object, None]) -> None:
        """Runs `work` to its end even if the caller is cancelled meanwhile."""
        task = asyncio.create_task(work)
        self._cleanups.add(task)
        task.add_done_callback(self._cleanups.discard)
        await asyncio.shield(task)

    def _connected(self) -> Link:
        if self._link is None:
            raise NotReady("not connected")
        return self._link

    def _axis(self, joint: str) -> Axis:
        axes = self._connected().axes
        if joint not in axes:
            raise NotReady(f"{joint}: no such joint here; there are {', '.join(axes)}")
        return axes[joint]


def _introduce(profile: CanopenProfile, bus: Bus) -> tuple[dict[str, Axis], tuple[AxisIdentity, ...]]:
    digest = hashlib.sha256(profile.eds.read_bytes()).hexdigest()
    axes: dict[str, Axis] = {}
    identities: list[AxisIdentity] = []
    for each in profile.axes:
        axis = Axis(each, profile, bus)
        identities.append(axis.identify(digest))
        axis.configure()
        axes[each.joint] = axis
    return axes, tuple(identities)


def _enable_alone(axis: Axis, axes: tuple[Axis, ...]) -> None:
    for other in axes:
        state = other.state()
        other.check(state)
        if other is not axis and state in states.ENERGISED:
            raise NotReady(f"{axis.place}: {other.place} is '{state.value}'; one axis at a time")
    axis.enable()


def _capabilities(axes: Iterable[Axis]) -> Capabilities:
    """What every axis can do."""
    everyone = tuple(axes)
    absent = frozenset[Entry]().union(*(axis.absent for axis in everyone))
    modes: set[SweepMode] = set()
    if all(axis.measures for axis in everyone):
        modes.add(SweepMode.DRIVE_SIDE)
    if all(axis.streams for axis in everyone):
        modes.add(SweepMode.HOST_STREAMED)
    return Capabilities(
        sweep_modes=frozenset(modes),
        load_encoder=SweepMode.DRIVE_SIDE in modes and all(axis.profile.load_encoder for axis in everyone),
        velocity_limit_in_drive=objects.MAX_MOTOR_SPEED not in absent,
        effort_limit_in_drive=objects.MAX_TORQUE not in absent,
        position_limits_in_drive=not absent & {objects.POSITION_MIN, objects.POSITION_MAX},
        host_watchdog_in_drive=not absent & {objects.HEARTBEAT_CONSUMER, objects.CONNECTION_LOSS},
        set_point_timing="thread" if SweepMode.HOST_STREAMED in modes else "none",
    )


async def _release(sdo: SdoThread, opening: asyncio.Task[Bus], heart: asyncio.Task[None] | None) -> None:
    """Ends heartbeat, bus and SDO thread; a bus that is still being opened is awaited and closed."""
    if heart is not None:
        heart.cancel()
        await asyncio.gather(heart, return_exceptions=True)
    with suppress(DriveError):  # a bus that was never open
        bus = await opening
        await sdo.run(bus.close)
    await sdo.close()
