"""Is J of a maker's drive, streamed, biased against the virtual drive's own sweeps? Many sweeps, several poses.

    python -m tests.benchmarks.makers_bias --drive epos4 --joint joint_3 --sweeps 30 [--wide] [--json FILE]

Both drives stand before the same plant, each with its own noise. Told are, of each pose and of all: the difference of J
in per cent, the standard deviation that the estimate states for it, and the one that the sweeps scatter by.
"""

import argparse
import asyncio
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers.contract.bench import closing
from drivers.ports import DrivePort, SweepMode
from drivers.registry import open_drive
from service.identification import identify, spectrum
from tests.benchmarks.sweeps import POSE, Run, command, move, robot, run, wide
from tests.contract.bench import BENCHES, DRIVES, in_one_process
from tests.contract.makers import profile
from tests.foreign_bench import bench

POSES = (POSE, POSE | {"joint_2": 0.3, "joint_3": 0.4}, POSE | {"joint_2": -0.7, "joint_3": -0.5})  # rad
PERIODS = {"epos4": 0.008, "plain": 0.008, "gold": 0.008, "simpliq": 0.004, "powerball": 0.004}  # s
Values = dict[int, list[float]]  # J of each sweep by number of the pose, kg m^2


async def swept(port: DrivePort, joint: str, mode: SweepMode, rate: float, sweeps: int, *, broad: bool) -> list[Run]:
    """So many sweeps of `joint` in each pose."""
    runs: list[Run] = []
    for pose in POSES:
        await move(port, pose)
        for _ in range(sweeps):
            start = pose[joint]
            one = wide(robot(), joint, start, mode, rate) if broad else command(robot(), joint, start, True, mode, rate)
            runs.append(await run(port, robot(), [one], pose))
            await move(port, {joint: start})
        print(f"{mode.value}: {len(runs)} sweeps", flush=True)
    return runs


async def measured(drive: str, joint: str, sweeps: int, *, broad: bool) -> tuple[list[Run], list[Run]]:
    """The maker's sweeps and the virtual drive's own."""
    with in_one_process(BENCHES["canopen-virtual"]) as virtual:
        async with closing(virtual.open()) as port:
            await port.connect()
            own = await swept(port, joint, SweepMode.DRIVE_SIDE, 250.0, sweeps, broad=broad)
    period = PERIODS[drive]
    with bench(drive) as foreign:
        content = profile(drive, foreign, DRIVES, patient=True, sync_period=period)
        async with closing(open_drive(content, DRIVES)) as port:
            await port.connect()
            return await swept(port, joint, SweepMode.HOST_STREAMED, 1 / period, sweeps, broad=broad), own


def judged(streamed: Sequence[Run], own: Sequence[Run], joint: str) -> list[dict[str, Any]]:
    """Of each pose, then of all: per cent of J."""
    runs = [*streamed, *own]
    order = sorted(range(len(runs)), key=lambda k: runs[k].sweeps[joint].spec.id)
    (axis,) = identify(robot(), [spectrum(robot(), runs[k].sweeps[joint]) for k in order]).axes
    values, covariance = np.empty(len(runs)), np.empty((len(runs), len(runs)))
    values[order] = [sweep.value for sweep in axis.sweeps]
    covariance[np.ix_(order, order)] = axis.covariance
    each = len(streamed) // len(POSES)
    numbers = np.arange(len(streamed))
    places = [(f"pose {k + 1}", numbers // each == k) for k in range(len(POSES))]
    rows: list[dict[str, Any]] = []
    for name, chosen in [*places, ("all", numbers >= 0)]:
        weights = np.concatenate([chosen, -chosen.astype(float)]) / chosen.sum()
        mean = float(values[len(streamed) :][chosen].mean())
        scatter = [float(np.var(part[chosen & (numbers // each == k)], ddof=1)) / each
                   for k in range(len(POSES)) if (chosen & (numbers // each == k)).any()
                   for part in (values[: len(streamed)], values[len(streamed) :])]  # fmt: skip
        poses = chosen.sum() / each
        rows.append(
            {
                "where": name,
                "sweeps": int(chosen.sum()),
                "inertia": mean,
                "bias": 100 * float(weights @ values) / mean,
                "std": 100 * float(np.sqrt(weights @ covariance @ weights)) / mean,
                "std_by_scatter": 100 * float(np.sqrt(sum(scatter))) / poses / mean,
            }
        )
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drive", choices=PERIODS, default="epos4")
    parser.add_argument("--joint", choices=("joint_1", "joint_2", "joint_3"), default="joint_3")
    parser.add_argument("--sweeps", type=int, default=30, help="of each drive in each pose")
    parser.add_argument("--wide", action="store_true", help="sweeps of 0.3 rad instead of 4 degrees")
    parser.add_argument("--json", type=Path, help="file for the result")
    options = parser.parse_args()
    streamed, own = asyncio.run(measured(options.drive, options.joint, options.sweeps, broad=options.wide))
    rows = judged(streamed, own, options.joint)
    for row in rows:
        print(
            f"{options.drive} {options.joint} {row['where']}: {row['sweeps']} sweeps each, J {row['inertia']:.2f}, "
            f"bias {row['bias']:+.3f} %, std {row['std']:.3f} %, by scatter {row['std_by_scatter']:.3f} %"
        )
    if options.json:
        result = {"drive": options.drive, "joint": options.joint, "wide": options.wide, "rows": rows}
        options.json.write_text(json.dumps(result, indent=1) + "\n", "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
