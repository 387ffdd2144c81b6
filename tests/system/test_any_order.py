"""Whatever happens, in whatever order and at whatever moment: nothing moves unasked, nothing is lost or counted twice.

A few steps of `tests/soak`, on a bus that the commit chooses; ``make soak`` takes each disturbance twenty times.
"""

import random
import subprocess
from pathlib import Path

from tests.soak.walk import WAYS, of, walking

STEPS = 3


def seed_of_the_commit() -> int:
    """The same again for the same commit; 0 without git."""
    found = subprocess.run(["git", "rev-parse", "HEAD"], cwd=Path(__file__).parent, capture_output=True, text=True)
    return int(found.stdout[:5] or "0", 16)


def test_nothing_moves_unasked_and_nothing_is_lost(tmp_path: Path) -> None:
    seed = seed_of_the_commit()
    way = random.Random(seed).choice(list(WAYS.values()))
    told = [f"python -m tests.soak {way.name} --seed {seed}"]
    with walking(way, tmp_path, seed, told.append) as (walk, watch):
        for disturbance in random.Random(seed).sample(of(way), STEPS):
            walk.disturb(disturbance)
        walk.finish()
    assert (watch.unasked, walk.tally.broken) == ([], []), "\n".join(told)
    assert walk.tally.done.total() == STEPS
    assert walk.tally.sweeps >= 1
