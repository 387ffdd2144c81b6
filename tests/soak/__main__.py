"""``python -m tests.soak WAY --repeats 20``: every disturbance so often, in a random order, at random moments.

Exit code 1 if anything moved unasked, or a sweep was lost or counted twice.
"""

import argparse
import json
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from random import Random, SystemRandom
from statistics import median
from time import monotonic

from tests.soak.walk import WAYS, Tally, of, walking
from tests.soak.watch import Watch


def main() -> int:
    wanted = argparse.ArgumentParser(prog="python -m tests.soak", description=(__doc__ or "").partition("\n")[0])
    wanted.add_argument("way", choices=list(WAYS))
    wanted.add_argument("--repeats", type=int, default=20)
    wanted.add_argument("--minutes", type=float, default=float("inf"), help="no disturbance begins after these")
    wanted.add_argument("--seed", type=int, help="of chance; told if it is not given")
    wanted.add_argument("--only", action="append", help="this disturbance, and others so named")
    wanted.add_argument("--json", type=Path, help="file for what came of it")
    given = wanted.parse_args()
    seed = SystemRandom().randrange(10**6) if given.seed is None else given.seed
    way, began = WAYS[given.way], monotonic()
    order = [each for each in of(way) if not given.only or each.name in given.only] * given.repeats
    Random(seed).shuffle(order)
    print(f"{way.name}: {len(order)} disturbances, seed {seed}", flush=True)
    with (
        tempfile.TemporaryDirectory() as folder,
        walking(way, Path(folder), seed, lambda line: print(line, flush=True)) as (walk, watch),
    ):
        try:
            for disturbance in order:
                if monotonic() > began + 60 * given.minutes:
                    break
                walk.disturb(disturbance)
            walk.finish()
        finally:  # hours of it are told even if something unforeseen ends them
            result = json.dumps(document(way.name, seed, walk.tally, watch), indent=1)
            print(result, flush=True)
            if given.json:
                given.json.write_text(result + "\n", "utf-8")
    return int(bool(watch.unasked or walk.tally.broken))


def document(way: str, seed: int, tally: Tally, watch: Watch) -> dict[str, object]:
    return {
        "way": way,
        "seed": seed,
        "at": datetime.now(UTC).isoformat(timespec="minutes"),
        "disturbances": {name: {"times": n, "ended": tally.ended[name]} for name, n in sorted(tally.done.items())},
        "moved_unasked": [f"{each.joint} {each.what} after {each.after}" for each in watch.unasked],
        "broken": tally.broken,
        "campaigns": tally.campaigns,
        "sweeps": tally.sweeps,
        "attempts": tally.attempts,
        "lost_ms": tally.lost,
        "to_rest_s": {"median": median(watch.rests or [0.0]), "longest": max(watch.rests, default=0.0)},
        "unplanned": tally.unplanned,
    }


if __name__ == "__main__":
    raise SystemExit(main())
