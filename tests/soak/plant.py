"""``python -m tests.soak.plant --sweeps 200``: one campaign while parts of the plant are killed at random moments.

The store is on PostgreSQL, recordings go to an S3 store (moto), four workers of a Dask scheduler identify. In a random
order, until the campaign is over: a worker or the scheduler is killed, the database restarted or killed, the way to the
object store cut. Afterwards each sweep must be identified once, and the last estimate must be, to 1e-9, what the
recordings give where there is no plant at all. Exit code 1 if not.
"""

import argparse
import json
import os
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from random import Random, SystemRandom

from service.client import Json, ServiceClient, ServiceProblem, ServiceUnreachable
from service.estimation import estimate_document
from service.identification import spectrum
from service.store.files.bundle import read_bundle
from tests.object_store_server import BUCKET, Wire, key_file, running_s3, wire_to
from tests.postgresql_server import PostgresqlServer, running_server
from tests.system.rest_bench import add_plan, differences, run, serving, until, virtual_machine
from tests.unit.service.cluster import DaskProcesses, certificates

WORKERS = 4
LEASE_TIME = 6.0  # s; half of it without a database, and the machine stands until a person resumes
CALM = (2.0, 12.0)  # s between two disturbances
STORE_GONE = (1.0, 30.0)  # s
NEAR = 1e-9  # relative, of every number of the last estimate; set before


class Plant:
    """What a person in charge of the plant would start again, and chance takes away."""

    def __init__(self, folder: Path, server: PostgresqlServer, wire: Wire, chance: Random) -> None:
        self.server, self.wire, self.chance = server, wire, chance
        self.dask = DaskProcesses.at_free_port(folder, certificates(folder / "authority", "plant"))
        self.dask.start_scheduler()
        self.tend()
        self.done: Counter[str] = Counter()

    @property
    def settings(self) -> dict[str, object]:
        files = self.dask.files
        return {
            "database_url": self.server.new_database(),
            "database_password_file": str(self.server.password_file),
            "recordings_url": f"s3://{BUCKET}/soak",
            "recordings_endpoint": self.wire.endpoint,
            "recordings_retry": 1.0,
            "dask_scheduler": self.dask.cluster.scheduler,
            "dask_authority": str(files.authority),
            "dask_certificate": str(files.certificate),
            "dask_key": str(files.key),
        }

    def disturb(self) -> str:
        """One of five, and all of it works again when this returns; its name."""
        each = (
            self.worker_killed,
            self.scheduler_killed,
            self.database_restarted,
            self.database_killed,
            self.store_gone,
        )
        chosen = self.chance.choice(each)
        chosen()
        self.tend()
        self.done[chosen.__name__] += 1
        return chosen.__name__

    def worker_killed(self) -> None:
        self.dask.workers[self.chance.randrange(len(self.dask.workers))].kill()

    def scheduler_killed(self) -> None:
        if self.dask.scheduler is not None:
            self.dask.scheduler.kill()
            self.dask.scheduler.wait()
        time.sleep(self.chance.uniform(0.0, 5.0))
        self.dask.start_scheduler()

    def database_restarted(self) -> None:
        self.server.stop()
        self.server.start()

    def database_killed(self) -> None:
        self.server.kill()
        time.sleep(self.chance.uniform(0.0, 2 * LEASE_TIME))
        self.server.start()

    def store_gone(self) -> None:
        self.wire.cut()
        time.sleep(self.chance.uniform(*STORE_GONE))
        self.wire.mend()

    def tend(self) -> None:
        """As many workers as wanted: those that ended, also with their scheduler, are started again."""
        for ended in [worker for worker in self.dask.workers if worker.poll() is not None]:
            self.dask.workers.remove(ended)
        while len(self.dask.workers) < WORKERS:
            self.dask.start_worker()


def resumed(client: ServiceClient, campaign: int) -> str:
    """State of the campaign; resumed, as a person would after looking at the machine, where it is paused."""
    with suppress(ServiceProblem, ServiceUnreachable):  # the database is away: the next look
        state = str(client.campaign(campaign)["state"])
        if state == "paused":
            client.resume(campaign, repeat=True)
        return state
    return "unknown"


def soak(folder: Path, sweeps: int, seed: int) -> Json:
    """What was disturbed, and what came of it."""
    began, calm = time.monotonic(), Random(seed)
    with running_server() as server, running_s3() as s3, wire_to(s3) as wire, virtual_machine(folder) as machine:
        plant = Plant(folder, server, wire, Random(seed + 1))
        try:
            keys = str(key_file(folder))
            with (
                serving(folder, machine.profile, LEASE_TIME, recordings_key_file=keys, **plant.settings) as service,
                ServiceClient(service.url) as client,
            ):
                plan = add_plan(client, axes=["joint_2", "joint_3"], poses=sweeps // 2, step=10.0)
                campaign = int(client.add_campaign(plan)["id"])
                client.start(campaign)
                while (state := resumed(client, campaign)) != "completed":
                    if state in ("failed", "aborted"):
                        raise RuntimeError(f"the campaign is {state}: {client.campaign(campaign)['cause']}")
                    quiet = time.monotonic() + calm.uniform(*CALM)
                    while time.monotonic() < quiet and resumed(client, campaign) != "completed":
                        time.sleep(0.5)
                    what = plant.disturb()
                    print(f"{time.monotonic() - began:6.0f} s  {what}", flush=True)
                until(lambda: len(s3.keys()) >= sweeps, "every recording is in the store", 600.0)
                measured = client.sweeps(campaign)
                revisions = client.estimates(campaign)
                latest = client.estimate(campaign)
                exported = run("export", str(campaign), str(folder / "bundle"), url=service.url)
                assert exported.returncode == 0, exported.stderr
        finally:
            plant.dask.close()
    bundle = read_bundle(folder / "bundle")
    undisturbed = estimate_document(bundle.robot, [spectrum(bundle.robot, sweep) for sweep in bundle.sweeps])
    path, worst = max(differences(latest["document"], undisturbed.as_json()), key=lambda found: found[1])
    numbers = [one["number"] for one in revisions]
    return {
        "sweeps": len(measured),
        "seed": seed,
        "seconds": time.monotonic() - began,
        "load": os.getloadavg()[0],
        "disturbances": dict(plant.done),
        "not_identified": [sweep["number"] for sweep in measured if sweep["state"] != "identified"],
        "without_revision": sorted({sweep["number"] for sweep in measured} - set(numbers)),
        "counted_twice": sorted(number for number, count in Counter(numbers).items() if count > 1),
        "attempts": sum(int(sweep["attempt"]) for sweep in measured),
        "largest_difference": worst,
        "where": path,
    }


def main() -> int:
    wanted = argparse.ArgumentParser(prog="python -m tests.soak.plant", description=(__doc__ or "").partition("\n")[0])
    wanted.add_argument("--sweeps", type=int, default=200)
    wanted.add_argument("--seed", type=int, default=SystemRandom().randrange(10**6))
    given = wanted.parse_args()
    with tempfile.TemporaryDirectory(prefix="plant-soak-") as folder:
        found = soak(Path(folder), given.sweeps, given.seed)
    print(json.dumps(found, indent=1))
    wrong = found["not_identified"] or found["without_revision"] or found["counted_twice"]
    return int(bool(wrong) or found["largest_difference"] > NEAR)


if __name__ == "__main__":
    raise SystemExit(main())
