"""A long host-streamed run over a real bus: is every sample there, in order, and is J that of the drive's own sweeps?

    python -m tests.benchmarks.streamed_run --bus vcan|socketcand --minutes 5 --axes 3 --rate 100 --busy 2 --json FILE
    tests/vcan/run .venv/bin/python -m tests.benchmarks.streamed_run --bus vcan ...     where the kernel has no CAN

The virtual machine (`sweepid drive`) is a process of its own, and so is the bus monitor (with --bus virtual both
are threads of this process: python-can's virtual bus reaches no further). Of every sweep the sample
indices, which are the drive's own counter, must be 0, 1, 2, ...; the bus monitor counts on the wire what the adapter
may have left out. Then all sweeps of an axis are identified together, drive-side ones of the same pose before and after
among them: J must agree within the stated standard deviation. Exit code 0 if all that holds, else 1.

Three axes stream at once, each with lines of its own. Their robot's axes do not feel each other's inertia (`coupled:
false` of the scenario), so that J can be compared with that of an axis which moves alone. But what one axis travels
changes the others' gravity and J: a slope that looks like gravity stiffness of their own, and J of another pose than in
the drive-side sweeps, which are taken in the middle of it all. Both change sign with the others' direction: all
relative directions take part alike (`DIRECTIONS`), the mean of J is compared (without noise it is the same within
0.03 %), and single sweeps are compared only where one axis moves alone.
"""

import argparse
import asyncio
import contextlib
import json
import logging
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast
from unittest.mock import patch

import numpy as np
import yaml
from numpy.typing import NDArray

from drivers.canopen import host_sweep
from drivers.ports import DrivePort, SweepCommand, SweepMode
from drivers.registry import open_drive
from service.robot import Robot
from tests.benchmarks import sweeps
from tests.benchmarks.bus_monitor import TPDO2, bus_monitor
from tests.benchmarks.punctuality import punctuality
from tests.contract import bench as contract
from tests.contract.bench import BENCHES, DRIVES

DRIVE_SIDE = 6  # sweeps of each axis before, and as many after
MEAN_Z, EACH_Z = 3.0, 4.5  # of the mean, and of the worst of some hundred
DIRECTIONS = {
    1: ((True,),),
    2: ((True, True), (True, False)),
}  # of each axis in the first of two sweeps, there and back
DIRECTIONS[3] = ((True, True, True), (True, True, False), (True, False, True), (False, True, True))


@contextlib.contextmanager
def busy(processes: int) -> Iterator[None]:
    """So many processes that do nothing but calculate."""
    calculate = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: sum(range(10_000))"
    running = [subprocess.Popen([sys.executable, "-c", calculate]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


async def measure(
    port: DrivePort, robot: Robot, joints: Sequence[str], seconds: float, rate: float
) -> list[sweeps.Run]:
    """Drive-side sweeps, `seconds` of host-streamed ones, drive-side sweeps again."""
    await sweeps.move(port, sweeps.POSE)
    before = await drive_side(port, robot, joints, rate)
    streamed = await host_streamed(port, robot, joints, seconds, rate)
    return [*before, *streamed, *await drive_side(port, robot, joints, rate)]


async def drive_side(port: DrivePort, robot: Robot, joints: Sequence[str], rate: float) -> list[sweeps.Run]:
    """`DRIVE_SIDE` sweeps of one axis after the other, the others in the middle of their way."""
    middle = {joint: sweeps.POSE[joint] + sweeps.way(robot, joint) / 2 for joint in joints}
    runs: list[sweeps.Run] = []
    await sweeps.move(port, middle)
    for joint in joints:
        await sweeps.move(port, {joint: sweeps.POSE[joint]})
        for number in range(DRIVE_SIDE):
            command = _command(robot, joint, number % 2 == 0, SweepMode.DRIVE_SIDE, rate)
            runs.append(await sweeps.run(port, robot, [command], sweeps.POSE | middle))
        await sweeps.move(port, {joint: middle[joint]})
        print(f"{joint}: {DRIVE_SIDE} drive-side sweeps", flush=True)
    return runs


async def host_streamed(
    port: DrivePort, robot: Robot, joints: Sequence[str], seconds: float, rate: float
) -> list[sweeps.Run]:
    """`seconds` of sweeps of all axes at once, there and back."""
    middle = {joint: sweeps.POSE[joint] + sweeps.way(robot, joint) / 2 for joint in joints}
    runs: list[sweeps.Run] = []
    streamed = 0.0
    while streamed < seconds:
        for first in DIRECTIONS[len(joints)]:
            ways = dict(zip(joints, first, strict=True))
            await sweeps.move(port, {joint: _start(robot, joint, forward) for joint, forward in ways.items()})
            for directions in (first, tuple(not way for way in first)):
                pairs = zip(joints, directions, strict=True)
                commands = [_command(robot, *pair, SweepMode.HOST_STREAMED, rate) for pair in pairs]
                runs.append(await sweeps.run(port, robot, commands, sweeps.POSE | middle))
                streamed += commands[0].duration
                print(_line(runs[-1], streamed), flush=True)
    return runs


def _start(robot: Robot, joint: str, forward: bool) -> float:
    """Where a sweep begins, rad."""
    return sweeps.POSE[joint] + (0.0 if forward else sweeps.way(robot, joint))


def _command(robot: Robot, joint: str, forward: bool, mode: SweepMode, rate: float) -> SweepCommand:
    return sweeps.command(robot, joint, _start(robot, joint, forward), forward, mode, rate)


def _line(run: sweeps.Run, streamed: float) -> str:
    counts = ", ".join(f"{joint} {index.count} samples" for joint, index in run.indices.items())
    faults = "" if all(index.gapless for index in run.indices.values()) else f" FAULTY: {run.indices}"
    missed = run.timing.missed if run.timing else 0
    return f"{streamed:6.1f} s streamed: {counts}, {missed} cycles missed{faults}"


def on_the_wire(frames: NDArray[np.void], run: sweeps.Run) -> dict[str, sweeps.Indices]:
    """The sample frames that a bus monitor saw of a host-streamed run, by joint."""
    seen: dict[str, sweeps.Indices] = {}
    for joint, delivered in run.indices.items():
        own = (frames["id"] == TPDO2 + int(joint[-1])) & (frames["time"] >= run.begin) & (frames["time"] <= run.end)
        counter = frames["counter"][own].astype(np.int64)
        seen[joint] = sweeps.count((counter - counter[0])[: delivered.count])
    return seen


def report(
    frames: NDArray[np.void],
    runs: list[sweeps.Run],
    joints: Sequence[str],
    robot: Robot,
    rate: float,
    seen: Callable[[NDArray[np.void], sweeps.Run], dict[str, sweeps.Indices]] = on_the_wire,
) -> dict[str, Any]:
    """Everything there is to say; `passed` is the verdict. `seen`: what the bus monitor saw of a run."""
    streamed = [run for run in runs if run.mode is SweepMode.HOST_STREAMED]
    wire = [seen(frames, run) for run in streamed]
    axes: dict[str, Any] = {}
    for joint in joints:
        delivered = [run.indices[joint] for run in streamed]
        expected = round(sweeps.command(robot, joint, 0.0, True, SweepMode.HOST_STREAMED, rate).duration * rate) + 1
        inertia = sweeps.compare(robot, runs, joint)
        axes[joint] = {
            "sweeps": len(streamed),
            "samples": _total(delivered),
            "on_the_wire": _total([each[joint] for each in wire]),
            "complete": all(index.count == expected and index.gapless for index in delivered),
            "inertia": {"streamed": inertia.streamed, "drive_side": inertia.drive_side, "std_of_a_sweep": inertia.std}
            | {"std_of_difference": inertia.difference_std, "z": inertia.z}
            | {"z_rms": float(np.sqrt(np.mean(inertia.each**2))), "z_worst": float(np.abs(inertia.each).max())},
        }
        agrees = abs(inertia.z) < MEAN_Z and (len(joints) > 1 or float(np.abs(inertia.each).max()) < EACH_Z)
        axes[joint]["passed"] = axes[joint]["complete"] and agrees
    sent = [run.timing for run in streamed if run.timing is not None]
    return {
        "axes": axes,
        "set_points": {
            "source": sent[0].source,
            "cycles": sum(each.cycles for each in sent),
            "missed": sum(each.missed for each in sent),
            "median_lateness": float(np.median([each.median_lateness for each in sent])),
            "worst_lateness": max(each.worst_lateness for each in sent),
        },
        "on_the_bus": asdict(punctuality(frames, streamed, 1 / rate)),
        "passed": all(axis["passed"] for axis in axes.values()),
    }


def _total(indices: Sequence[sweeps.Indices]) -> dict[str, int]:
    return {
        field: sum(getattr(index, field) for index in indices) for field in ("count", "lost", "doubled", "misordered")
    }


def summary(result: dict[str, Any]) -> str:
    """For people."""
    ms, told, seen = 1e3, result["set_points"], result["on_the_bus"]
    lines = [
        f"set-points by {told['source']}, as told by the host: {told['cycles']} cycles, {told['missed']} missed, "
        f"median {told['median_lateness'] * ms:.3f}, worst {told['worst_lateness'] * ms:.3f} ms late",
        f"on the bus, {seen['missed']} deadlines missed; ms: "
        + "; ".join(
            f"{name} median {spread['median'] * ms:.3f}, p99 {spread['p99'] * ms:.3f}, worst {spread['worst'] * ms:.3f}"
            for name, spread in (
                ("SYNC late", seen["lateness"]),
                ("SYNC to SYNC off the period", seen["interval"]),
                ("samples after SYNC", seen["answer"]),
            )
        ),
    ]
    for joint, axis in result["axes"].items():
        j = axis["inertia"]
        lines += [
            f"{joint}: {axis['sweeps']} sweeps, delivered {axis['samples']}, on the wire {axis['on_the_wire']}",
            f"  J {j['streamed']:.3f} streamed, {j['drive_side']:.3f} drive-side, difference "
            f"{j['streamed'] - j['drive_side']:+.3f} +- {j['std_of_difference']:.3f} kg m2 (z {j['z']:+.2f}); "
            f"one sweep +- {j['std_of_a_sweep']:.3f}, z rms {j['z_rms']:.2f}, worst {j['z_worst']:.2f}",
        ]
    return "\n".join([*lines, "PASSED" if result["passed"] else "FAILED"])


def uncoupled(scenario: Path, folder: Path) -> Path:
    """The scenario in a folder of its own, with axes that do not feel each other."""
    data = yaml.safe_load(scenario.read_text("utf-8"))
    data |= {"coupled": False, "robot": str((scenario.parent / data["robot"]).resolve())}
    path = folder / scenario.name
    path.write_text(yaml.safe_dump(data), "utf-8")
    return path


def stream(
    bus: str, joints: Sequence[str], seconds: float, rate: float, processes: int, *, thread: bool
) -> dict[str, Any]:
    """A whole run on a machine of its own, beside so many busy `processes`; `thread`: not by the kernel's timer."""
    bench, robot = BENCHES[f"canopen-{bus}"], sweeps.robot()
    with contextlib.ExitStack() as stack:
        if thread:
            stack.enter_context(patch.object(host_sweep, "set_point_source", lambda *_, **__: "thread"))
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        stack.enter_context(patch.object(contract, "SCENARIO", uncoupled(contract.SCENARIO, folder)))
        machine = stack.enter_context(bench.machine(bench))
        where = dict(cast("Mapping[str, Any]", machine.profile["bus"])) | {"sync_period": 1 / rate}

        async def connected() -> list[sweeps.Run]:
            port = open_drive({**machine.profile, "bus": where}, DRIVES)
            await port.connect()
            try:
                return await measure(port, robot, joints, seconds, rate)
            finally:
                await port.close()

        began = time.monotonic()
        with bus_monitor(where) as frames, busy(processes):
            runs = asyncio.run(connected())
    return {
        "bus": bus,
        "rate": rate,
        "busy": processes,
        "streamed": seconds,
        "took": time.monotonic() - began,
        "guest": "VCAN_GUEST" in os.environ,
        "processors": os.cpu_count(),
        "kernel": platform.release(),
        **report(frames[0], runs, joints, robot, rate),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bus", choices=("vcan", "socketcand", "virtual"), required=True)
    parser.add_argument("--minutes", type=float, default=5.0, help="of host-streamed sweeps")
    parser.add_argument("--axes", type=int, choices=(1, 2, 3), default=1, help="streamed at once")
    parser.add_argument("--rate", type=float, default=250.0, help="Hz: SYNC and samples")
    parser.add_argument("--busy", type=int, default=0, help="processes that calculate beside it")
    parser.add_argument(
        "--thread", action="store_true", help="set-points by a thread even where the kernel has a timer"
    )
    parser.add_argument("--json", type=Path, help="file for the result")
    options = parser.parse_args()
    logging.getLogger("can").setLevel(logging.ERROR)  # socketcand's client tells of every line cut in two
    joints = list(sweeps.LINES)[: options.axes]
    result = stream(options.bus, joints, 60 * options.minutes, options.rate, options.busy, thread=options.thread)
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n", "utf-8")
    print(summary(result))
    return 0 if result["passed"] else 1


if __name__ == "__main__":
    sys.exit(main())
