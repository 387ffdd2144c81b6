"""Scores the check of the data: `python -m tests.numeric.check_score --seed 5000 --sound 200 --rounds 6`.

Sound bundles must show nothing; every fault, put into another bundle in each round, must be told by name. Bundles whose
noise or whose design cannot show a fault are not left out: one that no repeats were measured of counts as missed.
"""

import argparse
import json
import multiprocessing
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from service.data_check import check
from tests.numeric.check_bundles import sound
from tests.numeric.check_faults import FAULTS


def of_sound(seed: int) -> list[str]:
    """Codes and sentences found in a sound bundle."""
    one = sound(seed)
    told = check(one.bundle.robot, one.bundle.sweeps)
    return [f"{seed} {one.hidden}: {finding.code}: {finding.sentence}" for finding in told]


def of_broken(job: tuple[int, tuple[str, ...]]) -> list[tuple[str, bool, list[str]]]:
    """For each fault put into one bundle: is it told by name, and all codes that were."""
    seed, names = job
    one, told = sound(seed), list[tuple[str, bool, list[str]]]()
    for name in names:
        random = np.random.default_rng([seed, list(FAULTS).index(name)])
        broken = FAULTS[name].apply(random, one)
        codes = [finding.code for finding in check(broken.robot, broken.sweeps)]
        told.append((name, bool(set(codes) & set(FAULTS[name].codes)), codes))
    return told


def jobs(seed: int, rounds: int, each: int = 7) -> list[tuple[int, tuple[str, ...]]]:
    """Every fault once a round; `each` faults share one sound bundle, shuffled."""
    result: list[tuple[int, tuple[str, ...]]] = []
    for number in range(rounds):
        names = np.random.default_rng([seed, number]).permutation(list(FAULTS)).tolist()
        parts = [tuple(names[k : k + each]) for k in range(0, len(names), each)]
        result += [(seed + 1000 * (number + 1) + k, part) for k, part in enumerate(parts)]
    return result


def score(seed: int, count: int, rounds: int, processes: int) -> dict[str, Any]:
    """Findings in sound bundles; by fault how often it was told by name, and what was told instead."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context) as pool:
        alarms = list(_watched(pool.map(of_sound, range(seed, seed + count)), count, "sound"))
        wanted = jobs(seed, rounds)
        broken = [one for told in _watched(pool.map(of_broken, wanted), len(wanted), "broken") for one in told]
    names = {name: [found for own, found, _ in broken if own == name] for name in FAULTS}
    instead = {name: Counter(c for own, found, codes in broken if own == name and not found for c in codes or ["-"])
               for name in FAULTS}  # fmt: skip
    return {
        "sound": {
            "bundles": count,
            "with_findings": sum(map(bool, alarms)),
            "findings": [line for lines in alarms for line in lines],
        },
        "broken": {
            "cases": len(broken),
            "named": sum(found for _, found, _ in broken),
            "faults": {
                name: {"cases": len(found), "named": sum(found), "instead": dict(instead[name])}
                for name, found in names.items()
            },
        },
    }


def _watched(results: Iterable[Any], total: int, what: str) -> Iterable[Any]:
    return track(results, what, total=total, console=Console(stderr=True))


def _main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=5000, help="of the first bundle")
    parser.add_argument("--sound", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=6, help="cases of each fault")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    told = score(given.seed, given.sound, given.rounds, given.processes)
    if given.json:
        print(json.dumps(told, indent=2))
        return
    clean, broken = told["sound"], told["broken"]
    console = Console()
    table = Table(title=f"{broken['named']} of {broken['cases']} faults told by name")
    for name in ("fault", "named", "instead"):
        table.add_column(name)
    for name, one in broken["faults"].items():
        table.add_row(name, f"{one['named']}/{one['cases']}", ", ".join(f"{c} {n}" for c, n in one["instead"].items()))
    console.print(table)
    console.print(f"{clean['with_findings']} of {clean['bundles']} sound bundles with findings")
    for line in clean["findings"]:
        console.print(f"  {line}", highlight=False)


if __name__ == "__main__":
    _main()
