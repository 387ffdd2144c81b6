"""Measures the punctuality of set-points and samples on each bus and its effect on J, and writes the page.

    python -m tests.benchmarks.timing measure [CASE...]   about three minutes per case; default: all cases
    python -m tests.benchmarks.timing write               docs/reference/timing.md from all stored results

A result is one JSON file of `streamed_run` in tests/benchmarks/results; long runs are stored there by --json
(long-*.json).
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.benchmarks.streamed_run import busy

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "tests" / "benchmarks" / "results"
PAGE = ROOT / "docs" / "reference" / "timing.md"
MINUTES = 0.4
CASES = {"virtual-thread": "virtual", "socketcand-thread": "socketcand", "vcan-thread": "vcan", "vcan-bcm": "vcan"}
LOADS = {"idle": 0, "loaded": 2}
BUSES = {"virtual": "python-can virtual", "socketcand": "socketcand", "vcan": "SocketCAN vcan0"}
Row = tuple[str, ...]
SOURCES = {"thread": "thread", "bcm": "kernel (BCM)"}

TEXT = """# Timing: set-points and samples

This page shows how punctual host-streamed sweeps are, and the effect of late set-points on the inertia. It is written
by `python -m tests.benchmarks.timing write` from the runs in `tests/benchmarks/results`; every number is measured. One
axis, 250 Hz, {seconds:.0f} s of sweeps per row. The computer has {processors} shared cores of a virtual server (Linux
{kernel}), without real-time kernel and without priorities. vcan runs in user-mode Linux on one of these cores, where a
system call takes about ten times as long. "Loaded" means two additional processes that only compute: host and virtual
machine share the cores with them; on vcan, host, virtual machine and kernel share one core with one of them. A
dedicated computer at a machine is more punctual. During all rows, short jobs with the lowest priority (SCHED_IDLE) ran
from time to time.

## On the bus

A bus monitor, a separate process, uses time stamps of every SYNC and every sample frame taken where the drive receives
them: by the kernel on vcan, by the server of the drive on socketcand. The lateness of SYNC is relative to the grid that
most cycles keep. If a deadline passes before the set-point can be sent, that cycle is left out and never compensated by
a burst. The kernel's broadcast manager counts an interval from its wake-up and is corrected to the grid from time to
time, so it drifts around the grid: assess it by the columns SYNC to SYNC. All times are in ms.

{punctuality}

## Effect on J

None. The clock of the samples is that of the drive: a set-point takes effect at its SYNC, and the sample contains the
drive's own counter, so a late cycle stretches the wall clock for both. The table shows J of axis 1 in one pose, kg m²,
from the host's sweeps and from the drive's own measuring function before and after them. z is their difference in its
standard deviations (one in twenty is beyond 2).

{inertia}

Late set-points can end a sweep: the drive's watchdogs stop an axis if set-points are missing (2121h of the virtual
drive, 2 s in its profile), and the host ends a sweep that misses more deadlines than the profile's `missed_cycles`.
{long_runs}"""

LONG = """
## Long runs

Several axes are streamed on one clock. In every sweep the drive's sample counters must be 0, 1, 2, ... without a gap,
as delivered, and J must agree with the drive-side sweeps; "on the wire" is the count of the bus monitor. The axes of
this virtual machine are not coupled (`coupled: false`), so that J of axes that move together can be compared with that
of a single axis. On a real arm they are coupled, and the inverse dynamics of six-axes trajectories is required.

Drives other than `virtual` are nodes with manufacturers' dictionaries without a counter
(`tests/benchmarks/uncounted_run.py`): their samples belong to the SYNC before them, the host waits for their answers
before the next SYNC, and "on the wire" counts the answers between two SYNCs. J drive-side is that of the virtual drive
with the same plant. {others}

{rows}
"""

BUS_HEAD = ("bus", "set-points by", "load", "cycles", "missed", "late: median", "p99", "worst")
BUS_HEAD += ("SYNC to SYNC, deviation: p99", "worst", "sample after SYNC: median", "p99", "worst")
BUS_HEAD += ("samples", "lost, duplicated, misordered")
J_HEAD = ("bus", "set-points by", "J idle", "z", "J loaded", "z", "J drive-side: idle, loaded", "std of the difference")
LONG_HEAD = ("bus", "drive", "set-points by", "minutes", "Hz", "busy processes", "axis", "sweeps", "samples")
LONG_HEAD += ("lost, doubled, misordered", "on the wire", "J streamed", "J drive-side", "z", "verdict")


def measure(*names: str) -> None:
    """The cases of these names, all if none is given. A failed verdict is a result, too."""
    RESULTS.mkdir(exist_ok=True)
    for name in names or CASES:
        bus = CASES[name]
        for load, processes in LOADS.items():
            print(f"-- {name}, {load}", flush=True)
            command = [sys.executable, "-m", "tests.benchmarks.streamed_run", "--bus", bus, "--minutes", str(MINUTES)]
            command += ["--json", str(RESULTS / f"{name}-{load}.json")]
            command += ["--thread"] if name.endswith("thread") else []
            if bus == "vcan":
                command = ["env", "VCAN_TIMEOUT=900", str(ROOT / "tests" / "vcan" / "run"), *command]
            with busy(processes):
                subprocess.run(command, cwd=ROOT, check=False)


def page() -> str:
    """The page of all stored results."""
    runs = {path.stem: json.loads(path.read_text("utf-8")) for path in sorted(RESULTS.glob("*.json"))}
    short = {(name, load): runs[f"{name}-{load}"] for name in CASES for load in LOADS if f"{name}-{load}" in runs}
    long = [run for name, run in runs.items() if name.startswith("long-")]
    rows = [row for run in long for row in _long(run)]
    pairs = [(short[name, "idle"], short[name, "loaded"]) for name in CASES if (name, "loaded") in short]
    host = next(run for run in short.values() if not run["guest"])
    return TEXT.format(
        seconds=host["set_points"]["cycles"] / host["rate"],
        processors=host["processors"],
        kernel=host["kernel"],
        punctuality=_table(BUS_HEAD, [_punctuality(run, load) for (_, load), run in short.items()]),
        inertia=_table(J_HEAD, [_inertia(*pair) for pair in pairs]),
        long_runs=LONG.format(rows=_table(LONG_HEAD, rows), others=_others(long)) if rows else "",
    )


def _table(head: Row, rows: Sequence[Row]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ("---",) * len(head), *rows))


def _who(run: dict[str, Any]) -> tuple[str, str]:
    return BUSES[run["bus"]], SOURCES[run["set_points"]["source"]]


def _punctuality(run: dict[str, Any], load: str) -> Row:
    seen = run["on_the_bus"]
    late, interval, answer = seen["lateness"], seen["interval"], seen["answer"]
    times = (*late.values(), interval["p99"], interval["worst"], *answer.values())
    samples = run["axes"]["joint_1"]["samples"]
    counts = str(samples["count"]), _faults(samples)
    return *_who(run), load, str(seen["cycles"]), str(seen["missed"]), *(f"{t * 1e3:.3f}" for t in times), *counts


def _inertia(idle: dict[str, Any], loaded: dict[str, Any]) -> Row:
    a, b = (run["axes"]["joint_1"]["inertia"] for run in (idle, loaded))
    streamed = [cell for each in (a, b) for cell in (f"{each['streamed']:.2f}", f"{each['z']:+.1f}")]
    drive_side = f"{a['drive_side']:.2f}, {b['drive_side']:.2f}"
    return *_who(idle), *streamed, drive_side, f"{a['std_of_difference']:.2f}, {b['std_of_difference']:.2f}"


def _long(run: dict[str, Any]) -> list[Row]:
    return [
        (
            BUSES[run["bus"]],
            run.get("drive", "virtual"),
            SOURCES[run["set_points"]["source"]],
            f"{run['streamed'] / 60:g}",
            f"{run['rate']:g}",
            str(run["busy"]),
            joint,
            str(axis["sweeps"]),
            str(axis["samples"]["count"]),
            _faults(axis["samples"]),
            _faults(axis["on_the_wire"]),
            f"{axis['inertia']['streamed']:.2f}",
            f"{axis['inertia']['drive_side']:.2f}",
            f"{axis['inertia']['z']:+.1f}",
            "passed" if axis["passed"] else "FAILED",
        )
        for joint, axis in run["axes"].items()
    ]


def _others(runs: Sequence[dict[str, Any]]) -> str:
    """Load of the computer by other work, for the runs that recorded it."""
    loads = [f"{run['drive']} {run['load']:.0f}" for run in runs if "load" in run]
    return f"Other work ran on the same computer; load average at the end: {', '.join(loads)}." if loads else ""


def _faults(samples: dict[str, int]) -> str:
    return ", ".join(str(samples[fault]) for fault in ("lost", "doubled", "misordered"))


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["measure", *names]:
            measure(*names)
        case ["write"]:
            PAGE.write_text(page(), "utf-8")
        case _:
            sys.exit(__doc__)
