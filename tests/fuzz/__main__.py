"""``make fuzz``: every parser of files from outside reads what no program wrote.

Allowed is that it is read or that the parser's documented error says why not. Anything else (another exception, death,
20 s, 1 GiB) is a finding. The files of its case are kept in the folder of findings, some of each kind, and
``python -m tests.fuzz --case FILE`` repeats it. Exit code 1.
"""

import argparse
import os
import sys
from pathlib import Path
from random import SystemRandom
from time import monotonic

# address space is what is limited: no pools and stacks for as many threads as there are cores
os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"

from tests.fuzz.case import KNOWN
from tests.fuzz.parsers import PARSERS
from tests.fuzz.run import Tally, fuzz, repeat


def main() -> int:
    wanted = argparse.ArgumentParser(prog="python -m tests.fuzz", description=(__doc__ or "").partition("\n")[0])
    wanted.add_argument("--cpu", type=float, default=600.0, help="s of CPU in all")
    wanted.add_argument("--least", type=int, default=1, help="cases a parser")
    wanted.add_argument("--seed", type=int, help="of chance; told if it is not given")
    wanted.add_argument("--parser", action="append", choices=list(KNOWN), help="this one, and others so named")
    wanted.add_argument(
        "--findings", type=Path, default=Path("var/fuzz"), help="folder where the cases of findings are kept"
    )
    wanted.add_argument("--case", type=Path, nargs="+", help="repeat the case of a finding's file, or of some")
    given = wanted.parse_args()
    if given.case is not None:
        return max([_show(path, repeat(path)) for path in given.case])
    seed = SystemRandom().randrange(10**6) if given.seed is None else given.seed
    names = given.parser or list(PARSERS)
    print(f"seed {seed}, {given.cpu:g} s of CPU for {len(names)} parsers", flush=True)
    folder = given.findings.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    share = given.cpu / len(names)
    heads = f"{'parser':24}{'cases':>8}{'read':>8}{'refused':>9}{'findings':>10}{'CPU s':>8}"
    print(f"\n{heads}{'slowest (number)':>20}{'largest (number)':>22}", flush=True)
    tallies: dict[str, Tally] = {}
    for name in names:
        tallies[name] = fuzz(name, seed, share, given.least, folder, _Progress(name))
        _row(name, tallies[name])  # as soon as it is known: the whole takes long
    return _sum(tallies)


class _Progress:
    """A line that is written again where it is a terminal, else one in 20 s."""

    def __init__(self, parser: str) -> None:
        self._parser = parser
        self._told = float("-inf")

    def __call__(self, tally: Tally) -> None:
        every, end = (0.5, "\r") if sys.stderr.isatty() else (20.0, "\n")
        if monotonic() > self._told + every:
            self._told = monotonic()
            line = f"{self._parser}: {tally.cases} cases, {tally.found} findings"
            print(line.ljust(70), end=end, file=sys.stderr, flush=True)


def _show(file: Path, tally: Tally) -> int:
    print(f"{file}: {', '.join(tally.findings or tally.outcomes)}")
    return int(bool(tally.findings))


def _row(name: str, tally: Tally) -> None:
    refused = tally.cases - tally.outcomes["read"] - tally.outcomes["finding"] - tally.outcomes["death"]
    row = f"{name:24}{tally.cases:8}{tally.outcomes['read']:8}{refused:9}{tally.found:10}{tally.cpu:8.1f}"
    slow, large = f"{tally.slowest[0]:.3f} s", f"{tally.largest[0] / 2**20:.1f} MiB"
    print(f"{row}{slow + f' ({tally.slowest[1]})':>20}{large + f' ({tally.largest[1]})':>22}", flush=True)


def _sum(tallies: dict[str, Tally]) -> int:
    found = sum(tally.found for tally in tallies.values())
    cases, cpu = sum(tally.cases for tally in tallies.values()), sum(tally.cpu for tally in tallies.values())
    print(f"{cases} cases, {found} findings in {cpu:.0f} s of CPU")
    for tally in tallies.values():
        for kind, paths in tally.findings.items():
            print(f"{kind}\n  python -m tests.fuzz --case {' '.join(str(path) for path in paths)}")
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
