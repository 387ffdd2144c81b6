"""``python -m tests.benchmarks.live_viewers --minutes 10 --rate 1000 --json FILE``: what live plots cost the machine.

Three axes move at once, each streamed by the host and sampled at `--rate`, in campaigns of trajectories in turn, so
that all see the same load of the computer. Watched: three browsers' streams (`form=json`) and a fourth that reads one
message in two seconds, all in a process of their own. Not watched: nobody. Bystander: nobody watches either, but a
process takes as much of the processors as that of the viewers did, as often; so what differs between bystander and
watched is the service's part. Asked: no sample lost, and no more set-points late than without viewers.
"""

import argparse
import json
import multiprocessing
import os
import tempfile
import time
from collections import Counter
from collections.abc import Generator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from multiprocessing.synchronize import Event
from pathlib import Path
from threading import Thread
from typing import TypeAlias
from urllib.request import urlopen

import numpy as np
import pyarrow.parquet as parquet
import yaml
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from service.client import Json, ServiceClient, ServiceProblem
from tests.system.rest_bench import PATIENT_LEASE, serving, virtual_machine

AXES = ("joint_1", "joint_2", "joint_3")
QUICK, SLOWLY = 3, 2.0  # streams of browsers, and s between two messages of the slow reader
PERIOD, PERIODS = 10.0, 2  # s, and how many of them a trajectory has
TRAJECTORIES = 3  # of a campaign
RESUMES = 5  # of a campaign, after pauses of a busy computer


@dataclass
class Side:
    """What the campaigns with, or without, viewers came to."""

    campaigns: int = 0
    seconds: float = 0.0
    samples: int = 0
    lost: int = 0
    not_complete: list[str] = field(default_factory=list)
    cycles: int = 0
    missed: int = 0
    medians: list[float] = field(default_factory=list)
    worst: list[float] = field(default_factory=list)
    pauses: list[str] = field(default_factory=list)

    def document(self) -> Json:
        return {
            "campaigns": self.campaigns,
            "seconds_recorded": round(self.seconds, 1),
            "samples": self.samples,
            "lost": self.lost,
            "not_complete": self.not_complete,
            "pauses": self.pauses,
            "set_points": self.cycles,
            "missed": self.missed,
            "missed_per_mille": round(1e3 * self.missed / max(self.cycles, 1), 3),
            "late_median_ms": round(1e3 * float(np.median(self.medians or [0.0])), 3),
            "late_worst_ms": round(1e3 * max(self.worst, default=0.0), 1),
        }


def main() -> int:
    wanted = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    wanted.add_argument("--minutes", type=float, default=10.0, help="of watched motion; as much is not watched")
    wanted.add_argument("--rate", type=float, default=1000.0, help="samples and set-points of each axis, Hz")
    wanted.add_argument("--json", type=Path, help="file for what came of it")
    given = wanted.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        result = measured(Path(folder), 60 * given.minutes, given.rate)
    text = json.dumps(result, indent=1)
    print(text)
    if given.json:
        given.json.write_text(text + "\n", "utf-8")
    return 0 if result["watched"]["lost"] == 0 else 1


def measured(folder: Path, seconds: float, rate: float) -> Json:
    """Campaigns in turn until those that are watched have recorded `seconds`."""
    sides = {"watched": Side(), "not_watched": Side(), "bystander": Side()}
    blocks: Counter[str] = Counter()
    spent = [0.0, 0.0]  # s of processor and of the clock, of the viewers' process
    with ExitStack() as stack:
        machine = stack.enter_context(virtual_machine(folder, 1.0))
        profile = yaml.safe_load(machine.profile.read_text("utf-8"))
        profile["bus"]["sync_period"] = 1 / rate
        machine.profile.write_text(yaml.safe_dump(profile), "utf-8")
        service = stack.enter_context(serving(folder, machine.profile, PATIENT_LEASE))
        client = stack.enter_context(ServiceClient(service.url))
        robot = next(robot for robot in client.robots() if robot["name"] == "max100-class")
        request = {"kind": "trajectory", "robot_id": robot["id"], "axes": list(AXES), "sample_rate": rate}
        request |= {"period": PERIOD, "periods": PERIODS, "trajectories": TRAJECTORIES, "move_velocity": 0.3}
        plan = client.add_plan(request)
        began, loads = os.getloadavg(), []
        while sides["watched"].seconds < seconds:
            for name, side in sides.items():
                campaign = int(client.add_campaign(plan["id"])["id"])
                with {
                    "watched": lambda campaign=campaign: viewers(service.url, campaign, blocks, spent),
                    "not_watched": nullcontext,
                    "bystander": lambda: bystander(spent[0] / spent[1], sum(blocks.values()) / spent[1]),
                }[name]():
                    _run(client, campaign, side)
                _count(service.data, campaign, rate, side)
                loads.append(os.getloadavg()[0])
                print(f"{name}: {json.dumps(side.document())}", flush=True)
        dropped = _figure(service.url, "sweepid_live_blocks_dropped_total")
    return {
        "at": datetime.now(UTC).isoformat(timespec="minutes"),
        "rate_hz": rate,
        "axes": len(AXES),
        "load": [round(began[0], 1), round(max(loads), 1)],
        **{name: side.document() for name, side in sides.items()},
        "messages": dict(blocks),
        "processor_of_viewers": round(spent[0] / spent[1], 4),
        "dropped_for_slow_readers": dropped,
    }


def _run(client: ServiceClient, campaign: int, side: Side) -> None:
    """To its end; a pause of a busy computer (a move that took too long) is noted, and the campaign resumed."""
    client.start(campaign)
    for _ in range(RESUMES):
        while (state := client.campaign(campaign))["state"] in ("running", "pausing"):
            time.sleep(1.0)
        if state["state"] in ("measured", "completed"):
            return
        side.pauses.append(str(state["cause"])[:120])
        print(f"campaign {campaign} {state['state']}: {state['cause']}", flush=True)
        try:
            if stops := client.stops():
                client.reset_stop("benchmark", [stop["id"] for stop in stops])
            client.connect()
            client.resume(campaign, repeat=True)
        except ServiceProblem as problem:  # the drives do not answer yet: the next attempt resumes
            print(f"campaign {campaign} not resumed: {problem}", flush=True)
    client.abort(campaign, "the benchmark goes on")


def _count(data: Path, campaign: int, rate: float, side: Side) -> None:
    """Its recordings: each sample of the drive's counter there, and how punctual the set-points were."""
    side.campaigns += 1
    runs: set[str] = set()
    for manifest in sorted((data / "recordings" / f"campaign-{campaign:06d}").glob("*.json")):
        if not manifest.with_suffix(".parquet").exists():
            continue  # a spectrum
        told = json.loads(manifest.read_text("utf-8"))
        time_ = parquet.read_table(manifest.with_suffix(".parquet"), columns=["time"])["time"].to_numpy()
        steps = np.rint(np.diff(time_) * rate)
        side.samples += len(time_)
        side.lost += int(np.maximum(steps - 1, 0).sum())
        if told.get("cause"):
            side.not_complete.append(f"{campaign}/{manifest.stem}: {told['cause']}"[:120])
        timing = told.get("set_point_timing")
        run = json.dumps(timing)
        if timing is None or run in runs:  # the axes of one trajectory share it
            continue
        runs.add(run)
        side.seconds += len(time_) / rate
        side.cycles += timing["cycles"]
        side.missed += timing["missed"]
        side.medians.append(timing["median_lateness"])
        side.worst.append(timing["worst_lateness"])


@contextmanager
def viewers(url: str, campaign: int, blocks: Counter[str], spent: list[float]) -> Generator[None]:
    """Three browsers' streams and a slow reader in a process of their own, as if on other computers."""
    context = multiprocessing.get_context("spawn")
    over, counts = context.Event(), context.Queue()
    process = context.Process(target=_watch, args=(url, campaign, over, counts))
    process.start()
    try:
        yield
    finally:
        over.set()
        seen, processor, clock = counts.get(timeout=60.0)
        for name, number in seen.items():
            blocks[name] += number
        spent[0] += processor
        spent[1] += clock
        process.join()


@contextmanager
def bystander(share: float, rate: float) -> Generator[None]:
    """A process that computes `share` of the time, `rate` times a second."""
    context = multiprocessing.get_context("spawn")
    over = context.Event()
    process = context.Process(target=_stand_by, args=(share, rate, over))
    process.start()
    try:
        yield
    finally:
        over.set()
        process.join()


def _stand_by(share: float, rate: float, over: Event) -> None:
    os.nice(10)
    while not over.wait(max(0.0, (1.0 - share) / rate)):
        until = time.process_time() + share / rate
        while time.process_time() < until:
            pass


_Counts: TypeAlias = "multiprocessing.Queue[tuple[dict[str, int], float, float]]"


def _watch(url: str, campaign: int, over: Event, counts: _Counts) -> None:
    os.nice(10)
    began = time.process_time(), time.monotonic()
    seen: Counter[str] = Counter()
    watching = [Thread(target=_view, args=(url, campaign, over, seen, "browsers", 0.0)) for _ in range(QUICK)]
    watching.append(Thread(target=_view, args=(url, campaign, over, seen, "slow reader", SLOWLY)))
    for one in watching:
        one.start()
    for one in watching:
        one.join()
    counts.put((dict(seen), time.process_time() - began[0], time.monotonic() - began[1]))


def _view(url: str, campaign: int, over: Event, seen: Counter[str], name: str, pause: float) -> None:
    address = f"{url.replace('http', 'ws', 1)}/api/v1/campaigns/{campaign}/live?form=json"
    with suppress(ConnectionClosed), connect(address, proxy=None, max_queue=1, ping_interval=None) as socket:
        while not over.wait(pause):
            with suppress(TimeoutError):
                json.loads(socket.recv(timeout=1.0))
                seen[name] += 1


def _figure(url: str, name: str) -> float | None:
    """The value of one of the service's own metrics."""
    with urlopen(f"{url}/metrics", timeout=60) as answer:
        lines = answer.read().decode().splitlines()
    return next((float(line.split()[-1]) for line in lines if line.startswith(name)), None)


if __name__ == "__main__":
    raise SystemExit(main())
