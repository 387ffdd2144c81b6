"""``python -m tests.benchmarks.paper_size --json FILE``: 900 sweeps through the service while people look on.

The paper's campaign on a virtual machine that runs faster than the clock: 300 poses of three axes, some two hours of
the machine's time. Ten clients ask for the campaign twice a second, three watch the samples live, and a fourth reads
them too slowly. Asked: no sweep lost, none twice, resident memory that grows by at most 60 MB from sweep 100 on in each
process, time of a revision that does not grow. Then its bundle is imported into a service of its own.
"""

import argparse
import json
import os
import sqlite3
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import psutil
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from service.client import Json, ServiceClient, ServiceProblem, ServiceUnreachable
from tests.system.rest_bench import PATIENT_LEASE, Service, add_plan, serving, virtual_machine

AXES = ("joint_1", "joint_2", "joint_3")
POLLING, VIEWING = 10, 3  # clients
EVERY, SLOWLY = 0.5, 2.0  # s between the requests of a client, and between the messages of the slow reader
BEGIN = 100  # sweep from which on memory is to be flat
STEP = 20  # sweeps between two looks at the memory
IMPORT = 600.0  # s that an import may take until the benchmark gives up
_GOES_ON = 5  # resumes after pauses of a busy computer


@dataclass
class Memory:
    """Resident memory, MB, by process, at numbers of sweeps done."""

    at: list[int] = field(default_factory=list)
    by_process: dict[str, list[float]] = field(default_factory=dict)

    def look(self, service: Service, done: int) -> None:
        self.at.append(done)
        for name, process in _processes(service).items():
            self.by_process.setdefault(name, []).append(process.memory_info().rss / 1e6)

    def growth(self) -> dict[str, dict[str, float]]:
        """MB from sweep `BEGIN` to the last look, the largest, and MB a sweep of the fitted line."""
        found: dict[str, dict[str, float]] = {}
        for name, values in self.by_process.items():
            late = [(at, value) for at, value in zip(self.at, values, strict=False) if at >= BEGIN]
            if len(late) > 1:
                at, value = np.array(late).T
                found[name] = {
                    "grown": round(float(value[-1] - value[0]), 1),
                    "largest": round(float(value.max()), 1),
                    "a_sweep": round(float(np.polyfit(at, value, 1)[0]), 4),
                }
        return found


@dataclass
class Audience:
    """What those who look on got."""

    answers: list[float] = field(default_factory=list)
    """s."""
    refused: Counter[str] = field(default_factory=Counter)
    blocks: Counter[str] = field(default_factory=Counter)


def main() -> int:
    wanted = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    wanted.add_argument("--poses", type=int, default=300)
    wanted.add_argument("--speed-factor", type=float, default=20.0)
    wanted.add_argument("--json", type=Path, help="file for what came of it")
    given = wanted.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        result = measured(Path(folder), given.poses, given.speed_factor)
    text = json.dumps(result, indent=1)
    print(text)
    if given.json:
        given.json.write_text(text + "\n", "utf-8")
    return 0


def measured(folder: Path, poses: int, factor: float) -> Json:
    """The campaign and the import, as figures."""
    with ExitStack() as stack:
        machine = stack.enter_context(virtual_machine(folder, factor))
        service = stack.enter_context(serving(folder, machine.profile, PATIENT_LEASE))
        client = stack.enter_context(ServiceClient(service.url))
        plan = add_plan(client, cell="workshop", axes=list(AXES), step=7.5, poses=poses, modes="drive_side")
        campaign = int(client.add_campaign(plan)["id"])
        audience, memory = Audience(), Memory()
        began = time.monotonic()
        with looking_on(service.url, campaign, audience):
            pauses = _run(client, service, campaign, memory)
        seconds = time.monotonic() - began
        told = _told(service.data / "sweepid.sqlite", campaign)
        archive = folder / "bundle.zip"
        client.export_bundle(campaign, archive)
    other = folder / "other"
    other.mkdir()
    with virtual_machine(other) as machine, serving(other, machine.profile, PATIENT_LEASE) as service:
        imported, import_memory = _import(service, archive)
    return {
        "at": datetime.now(UTC).isoformat(timespec="minutes"),
        "load": os.getloadavg(),
        "speed_factor": factor,
        "seconds": round(seconds, 1),
        "machine_hours": round(seconds * factor / 3600, 2),
        "pauses": pauses,
        **told,
        "memory_MB": memory.growth(),
        "answers": len(audience.answers),
        "answer_s": _spread(audience.answers),
        "refused": dict(audience.refused),
        "live_blocks": dict(audience.blocks),
        "bundle_MB": round(archive.stat().st_size / 1e6, 1) if archive.exists() else None,
        "import_s": round(imported, 1),
        "import_memory_MB": import_memory,
    }


def _run(client: ServiceClient, service: Service, campaign: int, memory: Memory) -> list[str]:
    """Until it is complete; why it was paused in between, and resumed."""
    client.start(campaign)
    pauses: list[str] = []
    while (state := client.campaign(campaign))["state"] != "completed":
        done = int(state["progress"]["done"])
        if done >= (memory.at[-1] + STEP if memory.at else STEP):
            memory.look(service, done)
            print(done, {name: round(values[-1]) for name, values in memory.by_process.items()}, flush=True)
        if state["state"] not in ("running", "measured", "pausing"):
            pauses.append(str(state["cause"]))
            print(f"{done} paused: {pauses[-1]}", flush=True)
            if len(pauses) > _GOES_ON:
                raise RuntimeError(f"campaign {campaign} is {state['state']}: {pauses}")
            if stops := client.stops():
                client.reset_stop("benchmark", [stop["id"] for stop in stops])
            client.connect()
            client.resume(campaign, repeat=True)
        time.sleep(0.2)
    memory.look(service, int(client.campaign(campaign)["progress"]["done"]))
    return pauses


def _told(file: Path, campaign: int) -> Json:
    """Whether each sweep was recorded and counted once; how long and how large revisions are."""
    with closing(sqlite3.connect(f"file:{file}?mode=ro", uri=True)) as database:
        sweeps = database.execute(
            "SELECT s.number, s.state, s.attempt, count(r.id) FROM sweep s LEFT JOIN recording r"
            " ON r.sweep_id = s.id AND r.state = 'complete' WHERE s.campaign_id = ? GROUP BY s.id",
            (campaign,),
        ).fetchall()
        revisions = database.execute(
            "SELECT e.revision, (julianday(e.created_at) - julianday(r.created_at)) * 86400, length(e.document)"
            " FROM estimate e JOIN recording r ON r.sweep_id = e.sweep_id AND r.state = 'complete'"
            " WHERE e.campaign_id = ? ORDER BY e.revision",
            (campaign,),
        ).fetchall()
    seconds = [float(row[1]) for row in revisions]
    third = max(len(revisions) // 3, 1)
    return {
        "sweeps": len(sweeps),
        "not_identified": [row[0] for row in sweeps if row[1] != "identified"],
        "complete_recordings_not_one": [row[0] for row in sweeps if row[3] != 1],
        "attempts": sum(int(row[2]) for row in sweeps),
        "revisions": len(revisions),
        "revision_s": {"first_third": _spread(seconds[:third]), "last_third": _spread(seconds[-third:])},
        "revision_bytes": {"first": revisions[0][2], "last": revisions[-1][2]},
        "database_MB": round(sum(part.stat().st_size for part in file.parent.glob(file.name + "*")) / 1e6, 1),
    }


def _import(service: Service, archive: Path) -> tuple[float, dict[str, float]]:
    """s until every sweep of the bundle is in an estimate, and the largest resident memory by process, MB."""
    largest: dict[str, float] = {}
    with ServiceClient(service.url) as client:
        began = time.monotonic()
        campaign = int(client.import_bundle(archive)["id"])
        while client.campaign(campaign)["state"] != "completed":
            for name, process in _processes(service).items():
                largest[name] = max(largest.get(name, 0.0), round(process.memory_info().rss / 1e6, 1))
            if time.monotonic() > began + IMPORT:
                break
            time.sleep(0.5)
    return time.monotonic() - began, largest


@contextmanager
def looking_on(url: str, campaign: int, audience: Audience) -> Iterator[None]:
    """Ten clients that ask, three viewers and a slow reader, each in a thread of its own."""
    over = threading.Event()
    people: list[Callable[[], None]] = [lambda: _asks(url, campaign, audience, over)] * POLLING
    people += [lambda: _views(url, campaign, audience, over, "viewer", 0.0)] * VIEWING
    people.append(lambda: _views(url, campaign, audience, over, "slow reader", SLOWLY))
    threads = [threading.Thread(target=one) for one in people]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        over.set()
        for thread in threads:
            thread.join()


def _asks(url: str, campaign: int, audience: Audience, over: threading.Event) -> None:
    with ServiceClient(url) as client:
        while not over.wait(EVERY):
            began = time.monotonic()
            try:
                client.campaign(campaign)
            except (ServiceProblem, ServiceUnreachable) as error:
                audience.refused[f"{type(error).__name__}: {error}"[:80]] += 1
            else:
                audience.answers.append(time.monotonic() - began)


def _views(url: str, campaign: int, audience: Audience, over: threading.Event, name: str, pause: float) -> None:
    address = f"{url.replace('http', 'ws', 1)}/api/v1/campaigns/{campaign}/live"
    with suppress(ConnectionClosed), connect(address, proxy=None, max_queue=1, ping_interval=None) as socket:
        while not over.wait(pause):
            with suppress(TimeoutError):
                socket.recv(timeout=1.0)
                audience.blocks[name] += 1


def _processes(service: Service) -> dict[str, psutil.Process]:
    own = psutil.Process(service.running().pid)
    found = {"service": own}
    for child in own.children(recursive=True):
        with suppress(psutil.NoSuchProcess):
            words = " ".join(child.cmdline())
            name = "stop process" if "stop_process" in words else "worker" if "spawn_main" in words else ""
            if name:
                found[name] = child
    return found


def _spread(values: Sequence[float]) -> dict[str, float]:
    """s."""
    if not values:
        return {}
    median, p95, p99 = np.quantile(values, (0.5, 0.95, 0.99))
    return {"median": round(median, 4), "p95": round(p95, 4), "p99": round(p99, 4), "longest": round(max(values), 4)}


if __name__ == "__main__":
    raise SystemExit(main())
