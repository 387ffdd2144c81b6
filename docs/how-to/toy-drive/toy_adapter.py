"""Toy drives: CiA 402 words and a measuring function as lines of JSON over TCP, in rad and N m of the motor."""

import asyncio
import hashlib
import json
import logging
import math
import socket
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from drivers.cia402.axis import Cia402Axis
from drivers.cia402.checks import DriveEnvelope
from drivers.cia402.connection import DriveThread, RunningSweep, capabilities, to_the_end
from drivers.cia402.device import Abilities, Feedback, MeasuringState, OperationMode
from drivers.cia402.host_watch import HostWatch
from drivers.cia402.machine import Cia402Machine
from drivers.cia402.profile import AxisProfile, Frozen, parse
from drivers.cia402.states import Controlword
from drivers.errors import CommunicationLost, ConnectionFailed, DriveError, NotReady, WrongConfiguration, WrongIdentity
from drivers.ports import AxisIdentity, Capabilities, SampleBlock, StopSender, SweepCommand

RATE = 250.0  # Hz, of the measuring function
logger = logging.getLogger(__name__)


class ToyAxis(AxisProfile):
    port: int


class ToyProfile(Frozen):
    adapter: Literal["toy"]
    host: str
    timeout: float = 1.0  # s for an answer
    watchdog: float = 3.0  # s without a message from the host, then the drive stops
    axes: tuple[ToyAxis, ...]


class Line:
    """A request and its answer. After an error the connection is not used again, because a message was lost."""

    def __init__(self, host: str, port: int, timeout: float, place: str) -> None:
        self._address, self._timeout, self._place = (host, port), timeout, place
        self._socket: socket.socket | None = None

    def open(self) -> None:
        try:
            self._socket = socket.create_connection(self._address, self._timeout)
            self._answers = self._socket.makefile("rb")
        except OSError as error:
            raise ConnectionFailed(f"{self._place}: {error}") from None

    def ask(self, call: str, *values: object) -> Any:
        if self._socket is None:
            raise CommunicationLost(f"{self._place}: the connection was lost")
        try:
            self._socket.sendall(json.dumps([call, *values]).encode() + b"\n")
            answer = json.loads(self._answers.readline())
        except (OSError, ValueError) as error:
            self.close()
            raise CommunicationLost(f"{self._place}: {call}: {error}") from None
        if "error" in answer:
            raise WrongConfiguration(f"{self._place}: {call}: {answer['error']}")
        return answer["value"]

    def close(self) -> None:
        if self._socket is not None:
            self._answers.close()
            self._socket.close()
            self._socket = None


class ToyDevice:
    """See `drivers.cia402.device.Device`."""

    emergency_stop_codes = (0x9000,)
    injector = None  # no torque injection
    page_size = 250

    def __init__(self, profile: ToyAxis, machine: ToyProfile) -> None:
        self.profile, self.place = profile, f"{profile.joint} (port {profile.port})"
        self.line = Line(machine.host, profile.port, machine.timeout, self.place)
        self._gear, self._watchdog, self._serial = profile.gear_ratio, machine.watchdog, 0

    def identify(self) -> AxisIdentity:
        told, wanted = self.line.ask("identity"), self.profile.identity
        for name in ("vendor", "product", "revision"):
            if told[name] != getattr(wanted, name):
                expected = f"the profile says {getattr(wanted, name):08X}h"
                raise WrongIdentity(f"{self.place}: {name} is {told[name]:08X}h, {expected}")
        dictionary = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
        return AxisIdentity(self.profile.joint, f"port {self.profile.port}", **told, dictionary_sha256=dictionary)

    def configure(self) -> Abilities:
        self.read_back()
        return Abilities(
            measures=True, injects=False, streams=False, host_watchdog=True,
            velocity_limit=False, effort_limit=False, position_limits=False,
        )  # fmt: skip

    def read_back(self) -> None:
        """Write the settings of the session and read them back."""
        wanted = {
            "watchdog": self._watchdog,
            "acceleration": self.profile.acceleration * abs(self._gear),
            "quick_stop": self.profile.quick_stop_deceleration * abs(self._gear),
        }
        held = self.line.ask("settings", wanted)
        if held != wanted:
            raise WrongConfiguration(f"{self.place}: wrote {wanted}, drive holds {held}")

    def settle_limits(self, velocity: float, effort: float, window: tuple[float, float]) -> None:
        """The drive has no such limits: the host monitors them."""

    def statusword(self) -> int:
        return self.line.ask("statusword")

    def control(self, controlword: int) -> None:
        self.line.ask("control", controlword)

    def set_mode(self, mode: OperationMode) -> None:
        """The drive has profile position mode only."""
        if mode is not OperationMode.PROFILE_POSITION:
            raise WrongConfiguration(f"{self.place}: has no mode {mode.name}")

    def allow_motion(self) -> None:
        self.read_back()

    def forbid_motion(self) -> None:
        """The command disable voltage is sufficient."""

    def reopen(self) -> None:
        """The drive always receives."""

    def check_alive(self) -> None:
        self.line.ask("statusword")

    def look_for_restart(self) -> None:
        """A drive that restarts closes the connection."""

    def announced_error(self) -> int | None:
        """The drive announces no errors: they are in the statusword."""
        return None

    def forget_error(self) -> None:
        """No announced error is stored."""

    def error_code(self) -> int:
        return self.line.ask("error")

    def error_text(self, code: int) -> str:
        return f"error {code:04X}h"

    def stop_unheard(self) -> None:
        """Without a connection the drive stops by its watchdog."""
        with suppress(DriveError):
            self.control(Controlword.QUICK_STOP)

    def motion(self) -> Feedback:
        position, velocity, torque = self.line.ask("motion")
        return Feedback(position / self._gear, velocity / self._gear, torque * self._gear)

    def hold_target(self) -> None:
        """A new target is valid from the new set-point bit."""

    def set_target(self, position: float, velocity: float) -> None:
        wanted = [position * self._gear, velocity * abs(self._gear)]
        if (held := self.line.ask("target", *wanted)) != wanted:
            raise WrongConfiguration(f"{self.place}: wrote target {wanted}, drive holds {held}")

    def prepare_measuring(self, command: SweepCommand) -> None:
        wave = {
            "offset": command.offset_velocity * self._gear,
            "sines": [asdict(sine) | {"amplitude": sine.amplitude * self._gear} for sine in command.sines],
            "ramp": command.ramp,
            "start": command.measure_from,
            "duration": command.duration,
        }
        if command.sample_rate != RATE:
            raise WrongConfiguration(f"{self.place}: measures at {RATE:g} Hz, not at {command.sample_rate:g} Hz")
        if self.line.ask("wave", wave) != wave:
            raise WrongConfiguration(f"{self.place}: drive holds another sweep than was written")

    def start_measuring(self) -> None:
        self.line.ask("start")

    def abort_measuring(self) -> None:
        self.line.ask("abort")

    def measuring_state(self) -> MeasuringState:
        return MeasuringState(self.line.ask("measuring"))

    def rejection(self) -> str:
        return "not enabled"

    def samples_recorded(self) -> int:
        return self.line.ask("recorded")

    def page(self, first: int, count: int) -> SampleBlock:
        rows = np.array(self.line.ask("page", first, count))
        if rows.shape != (count, 5) or not np.array_equal(rows[:, 0], np.arange(first, first + count)):
            raise CommunicationLost(f"{self.place}: page from {first} holds other samples")
        return SampleBlock(
            joint=self.profile.joint,
            index=rows[:, 0].astype(np.int64),
            time=rows[:, 0] / RATE,
            effort=rows[:, 1] * self._gear,
            velocity=rows[:, 2] / self._gear,
            position=rows[:, 3] / self._gear,
            velocity_setpoint=rows[:, 4] / self._gear,
        )


@dataclass(frozen=True, slots=True)
class ToyConnection:
    """See `drivers.cia402.connection.DriveConnection`."""

    thread: DriveThread
    heart: asyncio.Task[None]
    devices: Sequence[ToyDevice]
    axes: Mapping[str, Cia402Axis]
    identities: tuple[AxisIdentity, ...]
    capabilities: Capabilities
    sync_period: float = math.inf

    async def stream(self, sweeps: Sequence[tuple[SweepCommand, DriveEnvelope]], stop: threading.Event) -> RunningSweep:
        raise NotReady("toy drives take no streamed set-points")

    def halt(self, *, streaming: bool) -> None:
        """Next action of the thread: stop all drives first, and read from them afterwards."""
        self.thread.post(_each, [device.stop_unheard for device in self.devices])

    async def close(self) -> None:
        self.heart.cancel()
        await asyncio.gather(self.heart, return_exceptions=True)
        await _release(self.thread, self.devices)


class ToyFieldbus:
    """See `drivers.cia402.connection.Fieldbus`."""

    def __init__(self, profile: ToyProfile) -> None:
        self._profile = profile
        self.watch = HostWatch(profile.watchdog)  # outlives each connection

    async def open(self) -> ToyConnection:
        profile, thread = self._profile, DriveThread("toy")
        devices = [ToyDevice(axis, profile) for axis in profile.axes]
        axes = {device.profile.joint: Cia402Axis(device, self.watch) for device in devices}
        try:
            await thread.run(_each, [device.line.open for device in devices])
            identities = await thread.run(lambda: tuple(axis.introduce() for axis in axes.values()))
        except BaseException:
            await to_the_end(_release(thread, devices))
            raise
        heart = asyncio.create_task(_beat(thread, devices, self.watch.beat), name="toy heartbeat")
        return ToyConnection(thread, heart, devices, axes, identities, capabilities(axes.values()))

    def stop_sender(self) -> StopSender:
        raise NotReady("toy drives: the stop needs the service")


def from_profile(profile: Mapping[str, object], base: Path) -> Cia402Machine:
    """The adapter's factory (entry point ``sweepid.drives``). BadProfile names the key and the reason."""
    parsed = parse(ToyProfile, profile)
    return Cia402Machine(parsed.axes, ToyFieldbus(parsed))


def _each(calls: Sequence[Any]) -> None:
    for call in calls:
        call()


async def _beat(thread: DriveThread, devices: Sequence[ToyDevice], period: float) -> None:
    """In the event loop on purpose: a blocked host sends no sign of life, and the drives stop."""
    while True:
        for device in devices:
            with suppress(DriveError):  # the next request reports it
                await thread.run(device.check_alive)
        await asyncio.sleep(period)


async def _release(thread: DriveThread, devices: Sequence[ToyDevice]) -> None:
    await thread.run(_each, [device.line.close for device in devices])
    await thread.close()
