"""A long host-streamed run on drives that count no samples: is every sample of its own SYNC, and J that of others?

    python -m tests.benchmarks.uncounted_run --drive epos4|powerball|plain [--way WAY] --minutes 10 --busy 2 --json FILE

As `streamed_run`, over socketcand, on nodes made of that drive's dictionary (`sweepid drive --foreign`, a process of
its own). They have no sweep of their own: J is compared with the virtual drive's before the same plant, measured first.
On the wire the bus monitor counts the answers between one SYNC and the next: none is a lost one, a second one doubled.
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
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import yaml
from numpy.typing import NDArray

from drivers.canopen.device_map import Way
from drivers.contract.bench import closing
from drivers.registry import load_profile, open_drive
from tests.benchmarks import sweeps
from tests.benchmarks.bus_monitor import SYNC, TPDO2, bus_monitor
from tests.benchmarks.streamed_run import busy, drive_side, host_streamed, report, summary, uncoupled
from tests.contract import bench as contract
from tests.contract.bench import BENCHES, DRIVES, ROOT
from tests.contract.makers import profile
from tests.foreign_bench import Foreign, file_of

USUAL = {"epos4": Way.CYCLIC_VELOCITY, "powerball": Way.INTERPOLATED_POSITION, "plain": Way.CYCLIC_VELOCITY}
PERIODS = {way: 0.008 if way is Way.CYCLIC_VELOCITY else 0.004 for way in Way}  # s; stairs of positions bias J at 8 ms


@contextlib.contextmanager
def machine(drive: str, scenario: Path) -> Iterator[Foreign]:
    """Nodes of this drive in a process of their own."""
    command = [sys.executable, "-c", "from service.cli import main; main()", "drive", "--port", "0"]
    command += ["--scenario", str(scenario), "--foreign", str(file_of(drive)), "--speed-factor", "20"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            ready = json.loads(process.stdout.readline())
            bus = {"interface": "socketcand", "channel": "can0", "host": "127.0.0.1", "port": ready["port"]}
            profile: Any = load_profile(DRIVES / "virtual-max100.yaml")
            joints = [axis["joint"] for axis in profile["axes"]]
            yield Foreign(bus, ready["control_port"], dict.fromkeys(joints, file_of(drive)))
        finally:
            process.terminate()


def answers(frames: NDArray[np.void], run: sweeps.Run) -> dict[str, sweeps.Indices]:
    """What each window between two SYNCs held of an axis' position PDOs, but for the last window, which may be open."""
    mine = frames[(frames["time"] >= run.begin) & (frames["time"] <= run.end)]
    window = np.cumsum(mine["id"] == SYNC) - 1  # in the order of the bus
    seen: dict[str, sweeps.Indices] = {}
    for joint, delivered in run.indices.items():
        own = window[mine["id"] == TPDO2 + int(joint[-1])]
        own = own[own >= 0]
        told = np.bincount(own - own[0])[: delivered.count]
        seen[joint] = sweeps.Indices(len(told), int(np.sum(told == 0)), int(np.sum(np.maximum(told - 1, 0))), 0)
    return seen


async def own_sweeps(joints: Sequence[str], rate: float) -> list[sweeps.Run]:
    """The virtual drive's."""
    bench = BENCHES["canopen-virtual"]
    with bench.machine(bench) as virtual:
        async with closing(virtual.open()) as port:
            await port.connect()
            await sweeps.move(port, sweeps.POSE)
            return [run for _ in range(2) for run in await drive_side(port, sweeps.robot(), joints, rate)]


async def streamed(
    content: Mapping[str, Any], way: Way, joints: Sequence[str], seconds: float, rate: float
) -> list[sweeps.Run]:
    async with closing(open_drive(content, DRIVES)) as port:
        await port.connect()
        if not port.capabilities.set_points.startswith(way.value):
            raise ValueError(f"--way {way.value}: the drive takes {port.capabilities.set_points}")
        await sweeps.move(port, sweeps.POSE)
        return await host_streamed(port, sweeps.robot(), joints, seconds, rate)


def by(way: Way, content: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The profile with a map that has this way alone."""
    given = yaml.safe_load((DRIVES / content["device"]).read_text("utf-8"))
    path = folder / "map.yaml"
    path.write_text(yaml.safe_dump(given | {"excitation": [way.value]}), "utf-8")
    return content | {"device": str(path)}


def stream(drive: str, way: Way, joints: Sequence[str], seconds: float, processes: int) -> dict[str, Any]:
    """A whole run beside so many busy `processes`."""
    period = PERIODS[way]
    with tempfile.TemporaryDirectory() as folder:
        scenario = uncoupled(contract.SCENARIO, Path(folder))
        with patch.object(contract, "SCENARIO", scenario):
            own = asyncio.run(own_sweeps(joints, 250.0))
        with machine(drive, scenario) as foreign:
            content = by(way, profile(drive, foreign, DRIVES, patient=True, sync_period=period), Path(folder))
            began = time.monotonic()
            with bus_monitor(foreign.bus) as frames, busy(processes):
                runs = asyncio.run(streamed(content, way, joints, seconds, 1 / period))
            took = time.monotonic() - began
    return {
        "bus": "socketcand",
        "drive": drive,
        "way": way.value,
        "rate": 1 / period,
        "busy": processes,
        "streamed": seconds,
        "took": took,
        "guest": False,
        "processors": os.cpu_count(),
        "load": os.getloadavg()[1],  # of the last five minutes, whoever made it
        "kernel": platform.release(),
        **report(frames[0], [*own, *runs], joints, sweeps.robot(), 1 / period, answers),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drive", choices=USUAL, required=True)
    parser.add_argument("--way", choices=[way.value for way in Way], help="of the set-points")
    parser.add_argument("--minutes", type=float, default=10.0, help="of host-streamed sweeps")
    parser.add_argument("--axes", type=int, choices=(1, 2, 3), default=1, help="streamed at once")
    parser.add_argument("--busy", type=int, default=2, help="processes that calculate beside it")
    parser.add_argument("--json", type=Path, help="file for the result")
    options = parser.parse_args()
    logging.getLogger("can").setLevel(logging.ERROR)  # socketcand's client tells of every line cut in two
    way = USUAL[options.drive] if options.way is None else Way(options.way)
    result = stream(options.drive, way, list(sweeps.LINES)[: options.axes], 60 * options.minutes, options.busy)
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n", "utf-8")
    print(summary(result))
    return 0 if result["passed"] else 1


if __name__ == "__main__":
    sys.exit(main())
