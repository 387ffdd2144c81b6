"""Scores the diagnosis on blind cases of the project's own simulator, experiments included:

    python -m tests.numeric.blind.score --cases 10 --seed 1

Every case leaves two files, `truth/NNNN.json` and `diagnoses/NNNN.json`; the scorer alone reads the first. The score of
the documentation is that of machines the project did not simulate: `tests.numeric.second_plant.score`.
"""

import argparse
import json
import multiprocessing
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown
from rich.progress import track

from tests.numeric.blind.cases import SIZES, Case, Design, cases, scene
from tests.numeric.blind.diagnosing import ROUNDS, diagnosed
from tests.numeric.blind.page import page, result
from tests.numeric.blind.scoring import Outcome, Score


def run(case: Case, folder: Path, rounds: int = ROUNDS, *, twin: bool = False) -> int:
    """Build, measure, diagnose; its number."""
    one = scene(case)
    _write(folder / "truth" / f"{case.number:04}.json", one.truth.document())
    _write(folder / "diagnoses" / f"{case.number:04}.json", diagnosed(one.evidence(), rounds, twin=twin))
    return case.number


def run_all(wanted: Sequence[Case], folder: Path, processes: int, rounds: int, *, twin: bool) -> None:
    """All cases, in so many processes."""
    for name in ("truth", "diagnoses"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context) as pool:
        futures = [pool.submit(run, case, folder, rounds, twin=twin) for case in wanted]
        for future in track(
            as_completed(futures), total=len(futures), description="cases", console=Console(stderr=True)
        ):
            future.result()


def scores(folder: Path) -> list[Score]:
    """What lies in a folder, truth beside diagnosis."""
    return [
        Score(json.loads(path.read_text()), json.loads((folder / "diagnoses" / path.name).read_text()))
        for path in sorted((folder / "truth").glob("*.json"))
    ]


def _write(path: Path, document: object) -> None:
    path.write_text(json.dumps(document, default=float))


def _main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=10, help="of every effect in every size")
    parser.add_argument("--none", type=int, default=300)
    parser.add_argument("--pairs", type=int, default=72)
    parser.add_argument("--outside", type=int, default=64)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sizes", nargs="+", choices=list(SIZES), default=["medium", "large"])
    parser.add_argument("--design", choices=[design.value for design in Design], default="full")
    parser.add_argument("--effects", nargs="+", help="only cases that hide one of these")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="diagnoses at most")
    parser.add_argument("--twin", action="store_true", help="prove by the simulator, as `sweepid diagnose` does")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--keep", type=Path, help="folder for truth and diagnoses")
    parser.add_argument("--json", type=Path, help="the figures as a file")
    given = parser.parse_args()
    wanted = cases(
        given.seed, singles=given.cases, none=given.none, pairs=given.pairs, outside=given.outside,
        design=Design(given.design), sizes=given.sizes,
    )  # fmt: skip
    chosen = [case for case in wanted if not given.effects or set(given.effects) & set(case.names)]
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.keep or Path(scratch)
        run_all(chosen, folder, given.processes, given.rounds, twin=given.twin)
        found = scores(folder)
    command = (
        f"python -m tests.numeric.blind.score --design {given.design} --cases {given.cases} --none {given.none} "
        f"--pairs {given.pairs} --outside {given.outside} --rounds {given.rounds} --seed {given.seed} "
        f"{'--twin' if given.twin else ''}"
    )
    told = result(found, command)
    console = Console()
    console.print(Markdown(page({given.design: told})))
    for score in found:
        if not score.expected and score.outcome is not Outcome.TIE:
            said = ", ".join(sorted(score.tie_set)) or "-"
            console.print(f"{score.truth['number']:04} {score.truth['names']} {score.outcome.value}: {said}")
    if given.json:
        given.json.write_text(json.dumps(told, indent=2) + "\n")


if __name__ == "__main__":
    _main()
