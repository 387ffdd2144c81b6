"""The Modbus line of a profile: opened, every unit identified, watchdogs served by the heartbeat."""

import asyncio
import hashlib
import logging
import math
import secrets
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers.cia402.axis import Cia402Axis
from drivers.cia402.checks import DriveEnvelope
from drivers.cia402.connection import DriveThread, RunningSweep, capabilities, to_the_end
from drivers.cia402.host_watch import HostWatch
from drivers.errors import DriveError, NotReady
from drivers.modbus.device import ModbusDevice
from drivers.modbus.line import MasterLine
from drivers.modbus.profile import ModbusProfile
from drivers.modbus.registers import load_registers
from drivers.modbus.stop_sender import ModbusStopSender
from drivers.modbus.unit import ControlToken, RegisterUnit
from drivers.ports import AxisIdentity, Capabilities, SweepCommand

logger = logging.getLogger(__name__)


class ModbusFieldbus:
    """See `drivers.cia402.connection.Fieldbus`. Raises BadProfile if the register map cannot be used."""

    def __init__(self, profile: ModbusProfile) -> None:
        self._profile = profile
        self._map = load_registers(profile.registers)
        self._host = secrets.randbits(64)
        self.watch = HostWatch(profile.line.watchdog)

    async def open(self) -> "ModbusConnection":
        profile, thread, line = self._profile, DriveThread("modbus"), MasterLine(self._profile.line)
        digest = hashlib.sha256(profile.registers.read_bytes()).hexdigest()
        units = [RegisterUnit(line, each.unit_id, self._map, each.place) for each in profile.axes]
        control = ControlToken(units, self._map, self.watch, self._host)
        devices = [ModbusDevice(each, profile, self._map, digest, line, control) for each in profile.axes]
        axes = {device.profile.joint: Cia402Axis(device, self.watch) for device in devices}
        try:
            await thread.run(line.open)
            identities = await thread.run(lambda: tuple(axis.introduce() for axis in axes.values()))
        except BaseException:
            await to_the_end(_release(thread, line, None, control))
            raise
        heart = asyncio.create_task(_beat(thread, devices, control, line.beat), name="modbus-heartbeat")
        return ModbusConnection(thread, line, heart, devices, axes, identities, capabilities(axes.values()), control)

    def stop_sender(self) -> ModbusStopSender:
        """Raises NotReady on a serial line."""
        return ModbusStopSender(self._profile, self._map)


@dataclass(frozen=True, slots=True)
class ModbusConnection:
    """See `drivers.cia402.connection.DriveConnection`."""

    thread: DriveThread
    line: MasterLine
    heart: asyncio.Task[None]
    devices: Sequence[ModbusDevice]
    axes: Mapping[str, Cia402Axis]
    identities: tuple[AxisIdentity, ...]
    capabilities: Capabilities
    control: ControlToken
    sync_period: float = math.inf  # there is no cycle

    async def stream(self, sweeps: Sequence[tuple[SweepCommand, DriveEnvelope]], stop: threading.Event) -> RunningSweep:
        """Raises NotReady: polling is too slow and too irregular for set-points."""
        raise NotReady("host-streamed sweeps are not possible through Modbus")

    def halt(self, *, streaming: bool) -> None:
        """Executed next by the thread of the line, for all units before any unit is asked. The answer to a request that
        is under way is awaited for a short time only.
        """
        self.line.hurry()
        self.thread.post(_halt, self.line, self.devices)

    async def close(self) -> None:
        await _release(self.thread, self.line, self.heart, self.control)


async def _beat(thread: DriveThread, devices: Sequence[ModbusDevice], control: ControlToken, period: float) -> None:
    """A request to every unit. It runs on the event loop on purpose: if the host hangs, it stops, and the drives stop
    the axes.

    In the queue of the thread it waits for at most one page of the trace (`ModbusDevice.page_size`).
    """
    while True:
        for device in devices:
            try:
                await thread.run(device.beat)
            except DriveError as error:  # a refusal of one drive must not affect the others
                logger.error("heartbeat: %s", error)
        await thread.run(control.renew)
        await asyncio.sleep(period)


def _halt(line: MasterLine, devices: Sequence[ModbusDevice]) -> None:
    """Those that may move first: on a slow line the last of many is told much later."""
    try:
        for device in sorted(devices, key=lambda device: not device.may_move):
            try:
                device.halt()
            except DriveError as error:  # the others must be halted all the same
                logger.error("halt: %s", error)
    finally:
        line.stopped()


async def _release(
    thread: DriveThread, line: MasterLine, heart: asyncio.Task[None] | None, control: ControlToken
) -> None:
    """Ends heartbeat, control, line and thread, after the request in progress."""
    if heart is not None:
        heart.cancel()
        await asyncio.gather(heart, return_exceptions=True)
    await thread.run(control.release)
    await thread.run(line.close)
    await thread.close()
