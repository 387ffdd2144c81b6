"""From the wire to the disk: samples through the adapter and the recorder, against a bare python-can loop.

The bus is a socketcand gateway in a process of its own, ``python -m docs.benchmarks.wire CYCLES``, that sends as fast
as one reads: SYNC and two TPDOs of six nodes a cycle. Ours: the adapter's `CanopenBus` with its thread, sorting,
pairing, envelope, blocks of 0.1 s in SI units, and a `Recorder` an axis whose every block the disk has. The peer
receives frames, unpacks them and keeps the numbers. The host's own half of a cycle, sending, is in neither.
"""

import logging
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import can

from docs.benchmarks.measured import Measured
from drivers.canopen import frames
from drivers.canopen.bus import CanopenBus, SocketcandBus
from drivers.canopen.host_sweep import HostSweep
from drivers.canopen.profile import BusProfile, CanopenAxis, Codec
from drivers.canopen.streamed_axis import StreamedAxis, StreamRequest
from drivers.cia402.checks import DriveEnvelope
from drivers.cia402.profile import IdentityProfile
from drivers.ports import SweepCommand, SweepMode
from service.machine.execution.sweep_samples import Recorder

NODES = (1, 2, 3, 4, 5, 6)
ENABLED = 0x0027
AT_ONCE = 50  # cycles
CYCLES, PERIOD = 5000, 0.004  # s
LEAST_SHARE, REPEATS = 0.6, 5
PATIENCE = 10.0  # s


def cycle(number: int) -> bytes:
    """What is on the bus in one, with counters from 1."""
    told: list[tuple[int, bytes]] = [(frames.Cob.SYNC, b"")]
    for node in NODES:
        told.append((frames.Cob.TPDO1 + node, struct.pack("<Hih", ENABLED, 500 + number % 7, number % 100)))
        told.append((frames.Cob.TPDO2 + node, struct.pack("<iI", 1000 + number, number + 1)))
    return b"".join(f"< frame {identifier:03X} 1.0 {data.hex().upper()} >".encode() for identifier, data in told)


def flood(count: int) -> None:
    """After a client's first frame so many cycles; then wait for it to go, and for the next one."""
    cycles = [b"".join(cycle(n) for n in range(k, min(k + AT_ONCE, count))) for k in range(0, count, AT_ONCE)]
    with socket.create_server(("127.0.0.1", 0)) as listener:
        print(listener.getsockname()[1], flush=True)
        while True:
            client, _ = listener.accept()
            with client:
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                for told, asked in ((b"< hi >", b"< open can0 >"), (b"< ok >", b"< rawmode >")):
                    client.sendall(told)
                    client.recv(len(asked), socket.MSG_WAITALL)
                client.sendall(b"< ok >")
                try:
                    for many in cycles * bool(client.recv(64)):
                        client.sendall(many)
                    while client.recv(4096):
                        pass
                except (BrokenPipeError, ConnectionResetError):
                    continue


@contextmanager
def gateway(cycles: int) -> Iterator[int]:
    """The port of one."""
    command = [sys.executable, "-m", "docs.benchmarks.wire", str(cycles)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            yield int(process.stdout.readline())
        finally:
            process.terminate()


@dataclass(frozen=True)
class Taken:
    """Samples, and s from the first frame asked for to the last of them."""

    samples: int
    processor: float
    clock: float


class Watch:
    """Runs from here on."""

    def __init__(self) -> None:
        self._processor, self._clock = time.process_time(), time.perf_counter()

    def taken(self, samples: int) -> Taken:
        return Taken(samples, time.process_time() - self._processor, time.perf_counter() - self._clock)


def bare(port: int, cycles: int) -> Taken:
    """A loop of its own."""
    motions: list[tuple[int, ...]] = []
    places: list[tuple[int, ...]] = []
    with SocketcandBus("can0", "127.0.0.1", port, tcp_tune=True) as bus:
        watch = Watch()
        bus.send(can.Message(arbitration_id=frames.Cob.SYNC, is_extended_id=False))
        while len(places) < cycles * len(NODES):
            message = bus.recv(PATIENCE)
            if message is None:
                raise TimeoutError(f"{len(places)} samples came")
            function = message.arbitration_id & ~0x7F
            if function == frames.Cob.TPDO1:
                motions.append(struct.unpack("<Hih", message.data))
            elif function == frames.Cob.TPDO2:
                places.append(struct.unpack("<iI", message.data))
        return watch.taken(len(places))


def recorded(port: int, cycles: int, folder: Path) -> Taken:
    """Adapter and recorders."""
    profile = BusProfile(interface="socketcand", channel="can0", host="127.0.0.1", port=port, drive_timeout=60.0)
    requests = {node: _request(node, cycles) for node in NODES}
    axes = {node: StreamedAxis(request, PERIOD) for node, request in requests.items()}
    at_least = round(HostSweep.block_time / PERIOD)
    wanted = (cycles - cycles % at_least) * len(NODES)
    with closing(CanopenBus(profile, NODES)) as bus, ExitStack() as stack:
        recorders = {
            node: stack.enter_context(closing(Recorder(folder / f"{time.monotonic_ns()}-{node}.arrow", each.command)))
            for node, each in requests.items()
        }
        events, done = bus.open_stream(*NODES), 0
        for axis in axes.values():
            axis.begin()
        watch = Watch()
        bus.send(frames.Cob.SYNC, b"")
        while done < wanted:
            event = events.get(timeout=PATIENCE)
            if isinstance(event, frames.Sync):
                for axis in axes.values():
                    axis.sync()
                continue
            if not isinstance(event, frames.MotionPdo | frames.PositionPdo):
                raise ConnectionError(f"{event} among the samples")
            trouble = axes[event.node].take(event)
            if trouble is not None:
                raise ConnectionError(trouble.reason)
            block = axes[event.node].block(at_least)
            if block is not None:
                recorders[event.node].write(block)
                done += len(block.index)
        return watch.taken(done)


def _request(node: int, cycles: int) -> StreamRequest:
    """Radians are revolutions here: 10^-3 a step of velocity, 10^-6 one of position."""
    axis = CanopenAxis(
        joint=f"joint_{node}", node=node, identity=IdentityProfile(vendor=1, product=2, revision=3),
        gear_ratio=6.283185307179586, rated_torque=100.0, position_limits=(-100.0, 100.0), velocity_limit=10.0,
        effort_limit=1000.0, acceleration=20.0, quick_stop_deceleration=50.0, standstill_velocity=1e-3,
    )  # fmt: skip
    command = SweepCommand(
        joint=axis.joint, mode=SweepMode.HOST_STREAMED, offset_velocity=0.5, sines=(), period=cycles * PERIOD,
        periods=1, ramp=0.1, settle=0.1, sample_rate=1 / PERIOD, velocity_limit=5.0, effort_limit=1000.0,
        position_window=(-50.0, 50.0),
    )  # fmt: skip
    envelope = DriveEnvelope(command.velocity_limit, command.effort_limit, command.position_window, "rad", "N m")
    return StreamRequest(axis, Codec(axis.gear_ratio, 0.0, 100.0, 1e6, 1e-3), command, envelope, 0)


def run() -> Iterator[Measured]:
    logging.getLogger("can").setLevel(logging.CRITICAL)  # python-can tells of every line cut in two
    with gateway(CYCLES) as port, tempfile.TemporaryDirectory() as folder:
        turns = [(recorded(port, CYCLES, Path(folder)), bare(port, CYCLES)) for _ in range(REPEATS)]
    for unit in ("processor", "clock"):
        mine, theirs = ([each.samples / getattr(each, unit) for each in side] for side in zip(*turns, strict=True))
        ours, peer = statistics.median(mine), statistics.median(theirs)
        yield Measured(
            name=f"samples per second of the {unit}", unit="samples/s", ours=ours,
            peer=peer, beside="python-can's recv and struct alone", less=False, repeats=REPEATS,
            spread=(max(mine) - min(mine)) / ours, note=f"{turns[0][0].samples} samples, none lost",
            target=f">= {LEAST_SHARE:.0%} of the bare loop", met=ours >= LEAST_SHARE * peer,
        )  # fmt: skip


if __name__ == "__main__":
    flood(int(sys.argv[1]))
