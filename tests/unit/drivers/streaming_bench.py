"""Small drives on a real bus for the streaming host: they answer SYNC, obey RPDO1, and misbehave as a test says."""

import struct
import threading
import uuid
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import can

from drivers.canopen import frames
from drivers.canopen.bus import CanopenBus
from drivers.canopen.host_sweep import HostSweep
from drivers.canopen.profile import BusProfile, Codec
from drivers.canopen.streamed_axis import StreamRequest
from drivers.cia402.checks import DriveEnvelope
from drivers.ports import SampleBlock, SineCommand, SweepMode
from tests.unit.drivers import given

ENABLED, SWITCHED_ON, OFF = 0x27, 0x23, 0x40
PERIOD = 0.004
COUNTER = 0xFFFFFFF0  # wraps during the sweep

Frame = tuple[int, bytes]


@dataclass
class Drive:
    """One node. `mangle(k, frames)` gives what really goes out at the k-th SYNC, counted from 1."""

    node: int
    statusword: int = ENABLED
    velocity: int = 0
    position: int = 0
    counter: int = COUNTER
    offset: int = 0  # added to the position told
    counts: bool = True  # TPDO2 tells the sample counter, else the velocity once more
    mangle: Callable[[int, list[Frame]], list[Frame]] = lambda _, answer: answer
    obeyed: list[tuple[int, int]] = field(default_factory=list)  # controlword and target of every SYNC that had one
    _syncs: int = 0
    _pending: tuple[int, int] | None = None

    @property
    def _second(self) -> int:
        return self.counter if self.counts else self.velocity & 0xFFFFFFFF

    def set_point(self, data: bytes) -> None:
        self._pending = struct.unpack("<Hi", data)

    def sync(self) -> list[Frame]:
        self._syncs += 1
        self.counter = (self.counter + 1) & 0xFFFFFFFF
        self.position += self.velocity
        answer = [
            (frames.Cob.TPDO1 + self.node, struct.pack("<Hih", self.statusword, self.velocity, self.velocity % 1000)),
            (frames.Cob.TPDO2 + self.node, struct.pack("<iI", self.position + self.offset, self._second)),
        ]
        if self._pending is not None:
            controlword, target = self._pending
            self.obeyed.append(self._pending)
            if self.statusword == ENABLED and controlword != 0x0F:
                self.statusword, self.velocity = OFF, 0
            elif self.statusword == ENABLED:
                self.velocity = target
            elif controlword == 0x0F and self.statusword == SWITCHED_ON:
                self.statusword = ENABLED  # what must never happen
        self._pending = None
        return self.mangle(self._syncs, answer)


class Cabinet(threading.Thread):
    """The drives' side of the bus. `heard` is every frame of the host, in order."""

    def __init__(self, interface: str, channel: str, drives: Sequence[Drive]) -> None:
        super().__init__(name="cabinet")
        self.drives = {drive.node: drive for drive in drives}
        self.heard: list[int] = []
        self.bus = can.Bus(interface=interface, channel=channel)
        self._closing = threading.Event()

    def say(self, identifier: int, data: bytes = b"", error: bool = False) -> None:
        self.bus.send(
            can.Message(arbitration_id=identifier, data=data, is_extended_id=identifier > 0x7FF, is_error_frame=error)
        )

    def run(self) -> None:
        with suppress(can.CanError):  # a bus that the test takes away
            self._serve()

    def _serve(self) -> None:
        while not self._closing.is_set():
            message = self.bus.recv(0.05)
            if message is None or message.is_error_frame:
                continue
            identifier = message.arbitration_id
            self.heard.append(identifier)
            if identifier == frames.Cob.SYNC:
                for drive in self.drives.values():
                    for answer in drive.sync():
                        self.say(*answer)
            elif identifier & ~0x7F == frames.Cob.RPDO1 and identifier & 0x7F in self.drives:
                self.drives[identifier & 0x7F].set_point(bytes(message.data))

    def close(self) -> None:
        self._closing.set()
        self.join()
        self.bus.shutdown()


@dataclass
class Bench:
    """A bus with drives at one end and us at the other."""

    bus: CanopenBus
    settings: BusProfile
    cabinet: Cabinet
    wires: frames.Wires

    def request(self, node: int, **changes: object) -> StreamRequest:
        """Revolutions are radians here: raw velocity is 10^-3 rev/s, raw position 10^-6 rev."""
        axis = given.axis(
            joint=f"joint_{node}",
            node=node,
            gear_ratio=6.283185307179586,
            rated_torque=100.0,
            position_limits=(-100.0, 100.0),
            velocity_limit=10.0,
        )
        codec = Codec(axis.gear_ratio, 0.0, 100.0, 1e6, 1e-3)
        fields: dict[str, Any] = {
            "joint": axis.joint,
            "mode": SweepMode.HOST_STREAMED,
            "offset_velocity": 0.5 * node,
            "period": 0.2,
            "periods": 1,
            "ramp": 0.1,
            "settle": 0.1,
            "sample_rate": 1 / PERIOD,
            "velocity_limit": 5.0,
            "position_window": (-50.0, 50.0),
        }
        command = given.sweep(SineCommand(5.0, 0.1, 0.3), **(fields | changes))
        envelope = DriveEnvelope(command.velocity_limit, command.effort_limit, command.position_window, "rad", "N m")
        drive = self.cabinet.drives.get(node)
        counter = COUNTER if drive is None or drive.counts else None
        return StreamRequest(axis, codec, command, envelope, counter, wires=self.wires)

    def start(self, *requests: StreamRequest, stop: threading.Event | None = None) -> HostSweep:
        chosen = requests or tuple(self.request(node) for node in self.cabinet.drives)
        return HostSweep(self.bus, self.settings, chosen, stop or threading.Event())


@asynccontextmanager
async def bench(
    *drives: Drive, interface: str = "virtual", channel: str = "", **settings: object
) -> AsyncIterator[Bench]:
    """On a patient host: what is late is not judged unless the test says so."""
    channel = channel or f"stream-{uuid.uuid4()}"
    patient = {"host_timeout": 60.0, "drive_timeout": 60.0, "missed_cycles": 10**6, "silence": 0.4}
    profile = BusProfile(interface=interface, channel=channel, **(patient | settings))  # pyright: ignore[reportArgumentType]
    cabinet = Cabinet(interface, channel, drives)
    wires = frames.Wires(counted=all(drive.counts for drive in drives))
    bus = CanopenBus(profile, tuple(drive.node for drive in drives), wires)
    cabinet.start()
    try:
        yield Bench(bus, profile, cabinet, wires)
    finally:
        cabinet.close()
        bus.close()


async def run_to_end(run: HostSweep, each: Callable[[SampleBlock], object] = lambda _: None) -> list[SampleBlock]:
    """All blocks; held axes are released, as the machine does once they left the cyclic mode."""
    blocks: list[SampleBlock] = []
    async for block in run.blocks():
        each(block)
        blocks.append(block)
    run.release()
    await run.finished()
    return blocks
