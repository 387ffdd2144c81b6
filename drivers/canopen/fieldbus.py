"""The CAN bus of a profile: its load, opened with our heartbeat, every node identified; sweeps streamed over it."""

import asyncio
import hashlib
import logging
import math
import threading
from collections.abc import AsyncGenerator, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from drivers.canopen import frames
from drivers.canopen.bus import CanopenBus, set_point_source
from drivers.canopen.device import CanopenDevice
from drivers.canopen.host_sweep import HostSweep
from drivers.canopen.profile import BusProfile, CanopenProfile, bits
from drivers.canopen.sdo import PdoMapping
from drivers.canopen.stop_sender import CanopenStopSender
from drivers.canopen.streamed_axis import Ending, StreamRequest
from drivers.cia402.axis import Cia402Axis
from drivers.cia402.checks import DriveEnvelope
from drivers.cia402.connection import DriveThread, capabilities, to_the_end
from drivers.cia402.device import OperationMode
from drivers.cia402.host_watch import HostWatch
from drivers.errors import (
    CommunicationLost,
    ConnectionFailed,
    DriveError,
    EnvelopeLeft,
    LimitExceeded,
    MotionForbidden,
    SweepInterrupted,
)
from drivers.ports import AxisIdentity, BusTraffic, Capabilities, SampleBlock, SetPointTiming, SweepCommand

logger = logging.getLogger(__name__)


def frame_bits(size: int) -> int:
    """Longest data frame with an 11-bit identifier and `size` bytes, including interframe space (ISO 11898-1), in bits.

    The 34 bits from start bit to checksum and the data are stuffed, in the worst case after every fourth bit. 13
    bits are not stuffed.
    """
    return 34 + 8 * size + (34 + 8 * size - 1) // 4 + 13


def bus_load(settings: BusProfile, moving: Iterable[tuple[PdoMapping, ...]], nodes: int) -> float:
    """Share of the bit rate that a streamed sweep of axes with these PDOs uses; 0 if the profile has no bit rate.

    `stop` frames are not counted, because they are sent once.
    """
    if settings.bitrate is None:
        return 0.0
    return (_cycle(moving) / settings.sync_period + _heartbeats(settings, nodes)) / settings.bitrate


def check_bus_load(
    settings: BusProfile, moving: Iterable[tuple[PdoMapping, ...]], nodes: int, most: float = 0.7
) -> None:
    """Raises LimitExceeded if sweeps of axes with these PDOs need more than `most` of the bit rate (the rest is for
    SDO, EMCY, repeated frames), with the cycle that fits. Nothing is checked if the profile has no bit rate.
    """
    if settings.bitrate is None:
        return
    moving = tuple(moving)
    load = bus_load(settings, moving, nodes)
    if load <= most:
        return
    left = most * settings.bitrate - _heartbeats(settings, nodes)
    fits = (
        f"sync_period {math.ceil(_cycle(moving) / left * 1e3) * 1e-3:g} s fits" if left > 0 else "no sync_period fits"
    )
    raise LimitExceeded(
        f"bus {settings.channel}: a sweep of these axes takes {load:.0%} of {settings.bitrate} bit/s, "
        f"{most:.0%} are allowed; {fits}"
    )


def _cycle(moving: Iterable[tuple[PdoMapping, ...]]) -> int:
    """Bits of one cycle: SYNC and the PDOs of the moving axes."""
    sizes = [sum(bits(entry) for entry in pdo.mapped) // 8 for pdos in moving for pdo in pdos]
    return frame_bits(0) + sum(frame_bits(size) for size in sizes)


def _heartbeats(settings: BusProfile, nodes: int) -> float:
    """Bits per second."""
    return frame_bits(1) * (1 / settings.host_heartbeat + nodes / settings.drive_heartbeat)


class CanopenFieldbus:
    """See `drivers.cia402.connection.Fieldbus`."""

    def __init__(self, profile: CanopenProfile) -> None:
        self._profile = profile
        self.watch = HostWatch(profile.bus.host_timeout)

    async def open(self) -> "CanopenConnection":
        profile, thread = self._profile, DriveThread("can-sdo")
        nodes = tuple(axis.node for axis in profile.axes)
        opening = asyncio.create_task(
            thread.run(CanopenBus, profile.bus, nodes, profile.device_map.wires, self.watch), name="open the bus"
        )
        heart: asyncio.Task[None] | None = None
        try:
            bus = await asyncio.shield(opening)
            await check_alone(bus, profile)
            heart = asyncio.create_task(_beat(bus, profile), name="can-heartbeat")
            devices, axes, identities = await thread.run(_introduce, profile, bus)
        except BaseException:
            await to_the_end(_release(thread, opening, heart))
            raise
        source = set_point_source(bus, waits=profile.bus.waits(profile.device_map.wires))
        return CanopenConnection(
            profile,
            thread,
            opening,
            bus,
            heart,
            devices,
            axes,
            identities,
            capabilities(
                axes.values(),
                source,
                hears_other_hosts=True,
                bus_bitrate=profile.bus.bitrate,
                bus_load=_loads(profile, devices),
            ),
        )

    def stop_sender(self) -> CanopenStopSender:
        return CanopenStopSender(self._profile)


def _loads(profile: CanopenProfile, devices: Mapping[str, CanopenDevice]) -> list[float]:
    """Bus load by number of axes that move together; the axes with the largest PDOs are counted first."""
    each = sorted(devices.values(), key=lambda one: -bus_load(profile.bus, [one.cyclic_pdos], len(devices)))
    cyclic = [device.cyclic_pdos for device in each]
    return [round(bus_load(profile.bus, cyclic[:count], len(devices)), 4) for count in range(1, len(each) + 1)]


@dataclass(frozen=True, slots=True)
class CanopenConnection:
    """See `drivers.cia402.connection.DriveConnection`."""

    profile: CanopenProfile
    thread: DriveThread
    opening: asyncio.Task[CanopenBus]
    bus: CanopenBus
    heart: asyncio.Task[None]
    devices: Mapping[str, CanopenDevice]
    axes: Mapping[str, Cia402Axis]
    identities: tuple[AxisIdentity, ...]
    capabilities: Capabilities

    @property
    def bus_traffic(self) -> BusTraffic:
        return self.bus.traffic

    @property
    def sync_period(self) -> float:
        return self.profile.bus.sync_period

    async def stream(
        self, sweeps: Sequence[tuple[SweepCommand, DriveEnvelope]], stop: threading.Event
    ) -> "StreamedSweep":
        requests: list[StreamRequest] = []
        swept = [self.devices[command.joint] for command, _ in sweeps]
        check_bus_load(self.profile.bus, [device.cyclic_pdos for device in swept], len(self.devices))
        for device, (command, _) in zip(swept, sweeps, strict=True):
            _check_resolution(device, command)
        for command, envelope in sweeps:
            device = self.devices[command.joint]
            start = await self.thread.run(device.prepare_streaming)
            waiting = (start.counter, start.position, start.mode_bits, self.profile.device_map.wires)
            requests.append(StreamRequest(device.profile, device.codec, command, envelope, *waiting))
        run = HostSweep(self.bus, self.profile.bus, requests, stop)
        return StreamedSweep(run, self.thread, {command.joint: self.axes[command.joint] for command, _ in sweeps})

    def halt(self, *, streaming: bool) -> None:
        """Sends directly on the bus: the thread may be waiting for a node that does not answer.

        Sends no SYNC in addition to that of a stream, because its samples could not be assigned any more.
        """
        nodes = {device.profile.node: device for device in self.devices.values()}
        deaf = [node for node, device in nodes.items() if device.deaf]
        for identifier, data in frames.stop(nodes, deaf, sync=not streaming, wires=self.profile.device_map.wires):
            try:
                self.bus.shout(identifier, data)
            except CommunicationLost as error:  # a full send buffer may have room for the next frame
                logger.error("halt: %s", error)

    async def close(self) -> None:
        await _release(self.thread, self.opening, self.heart)


class StreamedSweep:
    """A host-streamed sweep and its end. See `drivers.cia402.connection.RunningSweep`."""

    def __init__(self, run: HostSweep, thread: DriveThread, axes: Mapping[str, Cia402Axis]) -> None:
        self.run = run
        self._thread, self._axes = thread, axes

    async def blocks(self) -> AsyncGenerator[SampleBlock, None]:
        async for block in self.run.blocks():
            yield block
        await self._conclude()

    streams = True

    def halt(self) -> None:
        self.run.halt()

    async def interrupted(self) -> None:
        """Waits until the stream has run the stop sequence of its axes itself."""
        await self.run.over()

    async def over(self) -> None:
        await self.run.over()

    def timing(self) -> SetPointTiming:
        return self.run.timing()

    async def _conclude(self) -> None:
        """Leave the cyclic mode while SYNC still runs, or raise the error that ended the sweep."""
        run = self.run
        if run.ending is Ending.COMPLETED:
            for axis in self._axes.values():
                await self._thread.run(axis.device.set_mode, OperationMode.PROFILE_POSITION)
            run.release()
        await run.finished()
        match run.ending:
            case Ending.COMPLETED:
                return
            case Ending.STOPPED:
                raise SweepInterrupted(run.reason, joint=run.joint)
            case Ending.FORBIDDEN:
                raise MotionForbidden(run.reason, joint=run.joint)
            case Ending.SILENT | Ending.MISCOUNTED | Ending.LATE | Ending.NOT_SENT:
                raise CommunicationLost(run.reason, joint=run.joint)
            case Ending.LEFT_STATE:
                axis = self._axes[run.joint]
                await self._thread.run(axis.check, await self._thread.run(axis.state))
                raise SweepInterrupted(run.reason, joint=run.joint)
            case Ending.LEFT_ENVELOPE | Ending.NO_STANDSTILL:
                raise EnvelopeLeft(run.reason, joint=run.joint, measured=run.measured)


def _check_resolution(device: CanopenDevice, command: SweepCommand) -> None:
    """LimitExceeded if the velocity or position unit of the drive is too coarse for the sines.

    20 velocity units per amplitude: rounding then changes a line by at most one in a thousand. 5 position units where
    positions are sent: the axis follows the rounding and the drive measures it, so it is noise of the motion and no
    error of the estimate; with fewer, mostly quantisation is sent.
    """
    unit = device.profile.unit
    speed = abs(float(device.codec.velocity(1.0)))
    place = abs(float(device.codec.position(1.0) - device.codec.position(0.0)))
    for sine in command.sines:
        if 0 < sine.amplitude < 20 * speed:
            raise LimitExceeded(
                device.place,
                f"a sine of {sine.amplitude:.3g} {unit}/s has fewer than "
                f"20 steps of the drive's velocity unit of {speed:.3g} {unit}/s",
            )
        amplitude = sine.amplitude / (2 * math.pi * sine.frequency)
        if device.way.positions and 0 < amplitude < 5 * place:
            raise LimitExceeded(
                device.place,
                f"a sine of {amplitude:.3g} {unit} at {sine.frequency:g} Hz has fewer than "
                f"5 steps of the drive's position unit of {place:.3g} {unit}",
            )


async def check_alone(bus: CanopenBus, profile: CanopenProfile) -> None:
    """Raises ConnectionFailed if another host uses our node id: the drives would not detect the loss of either host.

    Two heartbeats are required: frames held back by a gateway arrive together and may be from our previous
    connection.
    """
    settings = profile.bus
    for _ in range(2):
        await asyncio.sleep(3 * settings.host_heartbeat)
        if not bus.host_heard():
            bus.expect_nodes()
            bus.expect_no_host()
            return
    raise ConnectionFailed(
        f"bus {settings.interface} {settings.channel}: another host speaks as node {settings.host_node}; "
        "only one may have these drives"
    )


async def _beat(bus: CanopenBus, profile: CanopenProfile) -> None:
    """Our heartbeat, on the event loop on purpose: if the host hangs, it stops, and the drives stop the axes."""
    settings = profile.bus
    with suppress(CommunicationLost):  # the bus stores the reason and raises it at the next use
        while True:
            bus.check_alive()
            bus.send(frames.Cob.HEARTBEAT + settings.host_node, bytes([frames.NmtState.OPERATIONAL]))
            await asyncio.sleep(settings.host_heartbeat)


Introduced = tuple[dict[str, CanopenDevice], dict[str, Cia402Axis], tuple[AxisIdentity, ...]]


def _introduce(profile: CanopenProfile, bus: CanopenBus) -> Introduced:
    digest = hashlib.sha256(profile.eds.read_bytes()).hexdigest()
    devices = {each.joint: CanopenDevice(each, profile, bus, digest) for each in profile.axes}
    axes = {joint: Cia402Axis(device, bus.watch) for joint, device in devices.items()}
    return devices, axes, tuple(axis.introduce() for axis in axes.values())


async def _release(thread: DriveThread, opening: asyncio.Task[CanopenBus], heart: asyncio.Task[None] | None) -> None:
    """Ends heartbeat, bus and SDO thread. A bus that is still being opened is awaited and closed."""
    if heart is not None:
        heart.cancel()
        await asyncio.gather(heart, return_exceptions=True)
    with suppress(DriveError):  # a bus that was never opened
        bus = await opening
        await thread.run(bus.close)
    await thread.close()
