"""Many small jobs through a Dask scheduler and its workers: does any process grow with the jobs that it has done?

`python -m tests.soak.workers --tasks 10000` writes results/dask-workers.json. Resident memory of scheduler, workers and
of the service's end, which is this process, is looked at after `WARM` jobs and after each further tenth.
"""

import argparse
import asyncio
import json
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from service.worker import Worker, open_worker
from tests.unit.service.cluster import DaskProcesses, certificates

RESULT = Path(__file__).parent / "results" / "dask-workers.json"
WARM = 500  # jobs until what is loaded once is loaded, and bounded histories are half full
MOST_GROWTH = 20.0  # MiB of any process from then on, set before
AT_ONCE = 20
NUMBERS = 2000  # in a job and in its result, as large as a spectrum
WORKERS = 2


@dataclass(frozen=True)
class Reply:
    """Gives back other numbers than it got."""

    number: int
    values: tuple[float, ...]
    priority: int = 0

    @property
    def key(self) -> str:
        return f"reply-{self.number}"

    def __call__(self) -> list[float]:
        return [value + self.number for value in self.values]


def memory(processes: dict[str, int]) -> dict[str, float]:
    """Resident, MiB, by name of the process."""
    return {name: psutil.Process(pid).memory_info().rss / 2**20 for name, pid in processes.items()}


async def work(worker: Worker, first: int, count: int) -> None:
    """Jobs `first` and on, `AT_ONCE` at a time; each answer is what it should be."""
    numbers = iter(range(first, first + count))

    async def lane() -> None:
        for number in numbers:
            values = tuple(float(number % 97 + k) for k in range(NUMBERS))
            found = await worker.run_patiently(Reply(number, values))
            if found[-1] != values[-1] + number:
                raise RuntimeError(f"job {number} has the answer of another")

    await asyncio.gather(*(lane() for _ in range(AT_ONCE)))


async def soak(folder: Path, tasks: int) -> dict[str, Any]:
    """The looks at the memory, and by process how much it grew after `WARM` jobs."""
    dask = DaskProcesses.at_free_port(folder, certificates(folder / "authority", "plant"))
    began = time.monotonic()
    try:
        dask.start_scheduler()
        for _ in range(WORKERS):
            dask.start_worker()
        async with open_worker(dask.cluster) as worker:
            await work(worker, 0, WARM)
            assert dask.scheduler is not None
            named = {f"worker {k}": process.pid for k, process in enumerate(dask.workers, 1)}
            processes = {"scheduler": dask.scheduler.pid, **named, "service": os.getpid()}
            looks = [{"tasks": WARM, **memory(processes)}]
            step = max(1, (tasks - WARM) // 10)
            for first in range(WARM, tasks, step):
                await work(worker, first, min(step, tasks - first))
                looks.append({"tasks": min(first + step, tasks), **memory(processes)})
    finally:
        dask.close()
    growth = {name: looks[-1][name] - looks[0][name] for name in processes}
    told = {"tasks": tasks, "seconds": time.monotonic() - began, "load": os.getloadavg()[0]}
    return {**told, "growth_mib": growth, "most_mib": MOST_GROWTH, "looks": looks}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", type=int, default=10_000)
    parser.add_argument("--result", type=Path, default=RESULT)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="plant-soak-") as name:
        result = asyncio.run(soak(Path(name), options.tasks))
    options.result.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(result, indent=1))
