"""An archive identified again by one and by two Dask workers, in pairs, and what a sweep costs in time, rows and bytes.

`python -m tests.benchmarks.archive --sweeps 5000 --pairs 2` writes results/archive.json. The processor time of the
workers stands beside the time on the clock: on a busy computer the clock also counts what others compute.
"""

import argparse
import asyncio
import json
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil
from sqlalchemy import func, select, update

from service.estimation import estimate_document, sweep_spectrum
from service.results.identified.spectrum import AnySpectrum
from service.store import tables as t
from service.store.documents import CampaignState, SweepState
from service.store.files.spectra import encode_spectrum
from service.worker import Worker, open_worker
from tests.numeric.campaign import max100
from tests.stored_archive import Archive, archive, sweeps_of
from tests.unit.service.cluster import DaskProcesses, certificates

RESULT = Path(__file__).parent / "results" / "archive.json"
SEEDS, POSES = 5, 50  # different campaigns, and poses of two axes in each
PER_CAMPAIGN = 2 * POSES
LEAST = 1.8  # ratio of two workers on two cores, set before


def identified(found: Archive) -> int:
    """Every campaign completed with the estimate of all its sweeps, as its last job leaves it; bytes of an estimate."""
    robot, size = max100(), 0
    documents = [
        estimate_document(robot, [sweep_spectrum(robot, sweep) for sweep in sweeps_of(seed, POSES)]).as_json()
        for seed in range(SEEDS)
    ]
    copies = len(found.campaigns) // SEEDS
    with found.database.write(quiet=True) as session:
        session.execute(update(t.SweepRow).values(state=SweepState.IDENTIFIED))
        session.execute(update(t.CampaignRow).values(state=CampaignState.COMPLETED))
        for number, campaign in enumerate(found.campaigns):
            query = select(func.max(t.SweepRow.id)).where(t.SweepRow.campaign_id == campaign)
            document = documents[number // copies]
            size += len(json.dumps(document))
            sweep = session.scalars(query).one()
            session.add(t.EstimateRow(campaign_id=campaign, revision=1, sweep_id=sweep, document=document))
    return size // len(found.campaigns)


async def timed(found: Archive, folder: Path, count: int) -> dict[str, float]:
    """Identify all again with `count` workers of a new cluster: time on the clock and of their processors, s."""
    dask = DaskProcesses.at_free_port(folder, certificates(folder / "authority", "plant"))
    try:
        dask.start_scheduler()
        for _ in range(count):
            dask.start_worker()
        processes = [psutil.Process(worker.pid) for worker in dask.workers]
        async with open_worker(dask.cluster) as worker:
            await _warm(worker, found, count)
            before, began = _processor(processes), time.perf_counter()
            number = await found.again(worker)
            seconds = time.perf_counter() - began
            used = _processor(processes) - before
    finally:
        dask.close()
    batch = found.batches.batch(number)
    if batch.failed:
        raise RuntimeError(f"{batch.failed} campaigns have no result")
    told = {"workers": count, "seconds": seconds, "processor_seconds": used, "sweeps": batch.sweeps, "load": load()}
    print(told, flush=True)
    return told


def _new(folder: Path) -> Path:
    folder.mkdir()
    return folder


async def _warm(worker: Worker, found: Archive, count: int) -> None:
    """Each worker has loaded the mathematics."""
    while len(await worker.processes()) < count:  # noqa: ASYNC110
        await asyncio.sleep(0.1)
    await found.again(worker, found.campaigns[: 2 * count])


def _processor(processes: list[psutil.Process]) -> float:
    times = [process.cpu_times() for process in processes]
    return sum(one.user + one.system for one in times)


def load() -> float:
    return os.getloadavg()[0]


def bytes_of(found: Archive, database: int, estimate: int) -> dict[str, float]:
    """Of one sweep, mean: recording, manifest, spectrum, rows; and of an estimate of `PER_CAMPAIGN` sweeps."""
    files = list((found.files.path(found.store.recording(found.campaigns[0], 1)).parents[1]).rglob("*"))
    recordings = [path.stat().st_size for path in files if path.suffix == ".parquet"]
    manifests = [path.stat().st_size for path in files if path.suffix == ".json"]
    robot = max100()
    spectra: list[AnySpectrum] = [sweep_spectrum(robot, sweep).to_document() for sweep in sweeps_of(0, POSES)]
    return {
        "recording": sum(recordings) / len(recordings),
        "manifest": sum(manifests) / len(manifests),
        "spectrum": sum(len(encode_spectrum(one)[0]) for one in spectra) / len(spectra),
        "rows": database / len(recordings),
        "estimate": estimate,
        "samples": found.store.recording(found.campaigns[0], 1).samples,
    }


def run(sweeps: int, pairs: int) -> dict[str, Any]:
    copies = max(1, sweeps // (SEEDS * PER_CAMPAIGN))
    with tempfile.TemporaryDirectory(prefix="plant-archive-") as name:
        folder = Path(name)
        with archive(folder, SEEDS, POSES, copies) as found:
            rows = sum(path.stat().st_size for path in folder.glob("plant.sqlite*"))
            costs = bytes_of(found, rows, identified(found))
            runs = [(pair, count) for pair in range(pairs) for count in (1, 2)]
            measured = [asyncio.run(timed(found, _new(folder / f"{pair}-{count}"), count)) for pair, count in runs]
    ratios = [one["seconds"] / two["seconds"] for one, two in zip(measured[::2], measured[1::2], strict=True)]
    # what two cores that do nothing else could reach: the same work by two needs so much more of a processor
    could = [
        2 * one["processor_seconds"] / two["processor_seconds"]
        for one, two in zip(measured[::2], measured[1::2], strict=True)
    ]
    middle = sorted(ratios)[len(ratios) // 2]
    told = {
        "cores": os.cpu_count(),
        "runs": measured,
        "ratios": ratios,
        "ratios_by_processor": could,
        "least": LEAST,
        "reached": middle >= LEAST,
    }
    return {**told, "bytes": costs}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sweeps", type=int, default=5000)
    parser.add_argument("--pairs", type=int, default=1)
    given = parser.parse_args()
    result = run(given.sweeps, given.pairs)
    RESULT.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(result, indent=1))
