"""The CAN bus of a profile: opened, our heartbeat on it, every node introduced; sweeps streamed over it."""

import asyncio
import hashlib
import threading
from collections.abc import AsyncGenerator, Coroutine, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from drivers.canopen import frames
from drivers.canopen.bus import Bus
from drivers.canopen.device import CanopenDevice
from drivers.canopen.host_sweep import Ending, HostSweep
from drivers.canopen.profile import CanopenProfile
from drivers.cia402.axis import Axis
from drivers.cia402.checks import Envelope
from drivers.cia402.device import Mode
from drivers.cia402.thread import DriveThread
from drivers.errors import CommunicationLost, DriveError, EnvelopeLeft, SweepInterrupted
from drivers.ports import AxisIdentity, Capabilities, SampleBlock, SetPointTiming, SweepCommand, SweepMode


class CanopenFieldbus:
    """See `drivers.cia402.connection.Fieldbus`."""

    def __init__(self, profile: CanopenProfile) -> None:
        self._profile = profile

    async def open(self) -> "CanopenConnection":
        profile, thread = self._profile, DriveThread("can-sdo")
        nodes = tuple(axis.node for axis in profile.axes)
        opening = asyncio.create_task(thread.run(Bus, profile.bus, nodes))
        heart: asyncio.Task[None] | None = None
        try:
            bus = await asyncio.shield(opening)
            heart = asyncio.create_task(_beat(bus, profile), name="can-heartbeat")
            devices, axes, identities = await thread.run(_introduce, profile, bus)
        except BaseException:
            await _to_the_end(_release(thread, opening, heart))
            raise
        return CanopenConnection(
            profile, thread, opening, bus, heart, devices, axes, identities, _capabilities(axes.values(), bus)
        )


@dataclass(frozen=True, slots=True)
class CanopenConnection:
    """See `drivers.cia402.connection.Connection`."""

    profile: CanopenProfile
    thread: DriveThread
    opening: asyncio.Task[Bus]
    bus: Bus
    heart: asyncio.Task[None]
    devices: Mapping[str, CanopenDevice]
    axes: Mapping[str, Axis]
    identities: tuple[AxisIdentity, ...]
    capabilities: Capabilities

    @property
    def sync_period(self) -> float:
        return self.profile.bus.sync_period

    async def stream(self, sweeps: Sequence[tuple[SweepCommand, Envelope]], stop: threading.Event) -> "StreamedSweep":
        # interim: one lane, until HostSweep takes several
        ((command, envelope),) = sweeps
        device = self.devices[command.joint]
        counter = await self.thread.run(device.prepare_streaming)
        run = HostSweep(self.bus, device.profile, self.profile.bus, device.codec, command, envelope, counter, stop)
        return StreamedSweep(run, self.thread, {command.joint: self.axes[command.joint]})

    async def close(self) -> None:
        await _release(self.thread, self.opening, self.heart)


class StreamedSweep:
    """A host-streamed sweep with its conclusion. See `drivers.cia402.connection.Run`."""

    def __init__(self, run: HostSweep, thread: DriveThread, axes: Mapping[str, Axis]) -> None:
        self.run = run
        self._thread, self._axes = thread, axes

    async def blocks(self) -> AsyncGenerator[SampleBlock, None]:
        async for block in self.run.blocks():
            yield block
        await self._conclude()

    async def interrupted(self) -> None:
        """The ladder of a streaming axis is the stream's own."""
        await self.run.over()

    async def over(self) -> None:
        await self.run.over()

    def timing(self) -> SetPointTiming:
        return SetPointTiming('thread', len(self.run.timing.lateness), self.run.timing.missed, 0.0, 0.0)

    async def _conclude(self) -> None:
        """Leave the cyclic mode while SYNC still runs, or raise what ended the sweep."""
        run = self.run
        if run.ending is Ending.COMPLETED:
            for axis in self._axes.values():
                await self._thread.run(axis.device.set_mode, Mode.PROFILE_POSITION)
            run.release()
        await run.finished()
        match run.ending:
            case Ending.COMPLETED:
                return
            case Ending.STOPPED:
                raise SweepInterrupted(f"{', '.join(axis.place for axis in self._axes.values())}: sweep was stopped")
            case Ending.SILENT:
                raise CommunicationLost(run.reason)
            case Ending.LEFT_STATE:
                (axis,) = self._axes.values()
                await self._thread.run(axis.check, await self._thread.run(axis.state))
                raise SweepInterrupted(run.reason)
            case Ending.LEFT_ENVELOPE | Ending.NO_STANDSTILL:
                raise EnvelopeLeft(run.reason)


async def _beat(bus: Bus, profile: CanopenProfile) -> None:
    """Our heartbeat, from the event loop on purpose: a host that hangs falls silent, and the drives stop."""
    settings = profile.bus
    with suppress(CommunicationLost):  # the bus keeps the reason; whoever uses it next gets it
        while True:
            bus.check_alive()
            bus.send(frames.HEARTBEAT + settings.host_node, bytes([frames.OPERATIONAL]))
            await asyncio.sleep(settings.host_heartbeat)


Introduced = tuple[dict[str, CanopenDevice], dict[str, Axis], tuple[AxisIdentity, ...]]


def _introduce(profile: CanopenProfile, bus: Bus) -> Introduced:
    digest = hashlib.sha256(profile.eds.read_bytes()).hexdigest()
    devices = {each.joint: CanopenDevice(each, profile, bus, digest) for each in profile.axes}
    axes = {joint: Axis(device) for joint, device in devices.items()}
    return devices, axes, tuple(axis.introduce() for axis in axes.values())


def _capabilities(axes: Iterable[Axis], bus: Bus) -> Capabilities:
    """What every axis can do."""
    everyone = tuple(axes)
    each = tuple(axis.abilities for axis in everyone)
    modes: set[SweepMode] = set()
    if all(abilities.measures for abilities in each):
        modes.add(SweepMode.DRIVE_SIDE)
    streams = all(abilities.streams for abilities in each)
    if streams:
        modes.add(SweepMode.HOST_STREAMED)
    return Capabilities(
        sweep_modes=frozenset(modes),
        load_encoder=SweepMode.DRIVE_SIDE in modes and all(axis.profile.load_encoder for axis in everyone),
        velocity_limit_in_drive=all(abilities.velocity_limit for abilities in each),
        effort_limit_in_drive=all(abilities.effort_limit for abilities in each),
        position_limits_in_drive=all(abilities.position_limits for abilities in each),
        host_watchdog_in_drive=all(abilities.host_watchdog for abilities in each),
        set_point_timing='thread' if streams else "none",
        simultaneous_axes=1,
    )


async def _release(thread: DriveThread, opening: asyncio.Task[Bus], heart: asyncio.Task[None] | None) -> None:
    """Ends heartbeat, bus and SDO thread; a bus that is still being opened is awaited and closed."""
    if heart is not None:
        heart.cancel()
        await asyncio.gather(heart, return_exceptions=True)
    with suppress(DriveError):  # a bus that was never open
        bus = await opening
        await thread.run(bus.close)
    await thread.close()


async def _to_the_end(work: Coroutine[object, object, None]) -> None:
    """A bus must not stay open because somebody loses patience twice."""
    task = asyncio.create_task(work)
    while not task.done():
        with suppress(asyncio.CancelledError):
            await asyncio.wait([task])
    task.result()
