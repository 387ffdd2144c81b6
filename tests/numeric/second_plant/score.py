"""Scores the diagnosis on machines of the second plant, e.g.

    python -m tests.numeric.second_plant.score --seed 1 --singles 10 --none 100 --pairs 60 --triples 30 --outside 64
        --nominal 70 --small --processes 2 --keep cases --write

--keep leaves the sweeps (one npz a case), the truths and the diagnoses in three folders, and what is there is not done
again; --again diagnoses all of them anew without stepping a machine. --write puts the page into docs/reference and the
figures beside the other benchmarks' results. The worker that diagnoses reads robot and sweeps alone.
--paper diagnoses healthy machines and medium and large singles once more, from no more than what the paper measures.
"""

import argparse
import datetime
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markdown import Markdown
from rich.progress import track

from service.diagnosis.diagnose import diagnose_axis
from service.diagnosis.document import axis_document
from tests.numeric.second_plant.cases import Case, Kind, cases, make
from tests.numeric.second_plant.kept import load, save
from tests.numeric.second_plant.page import page, result
from tests.numeric.second_plant.scoring import Score

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs/reference/diagnosis-scores.md"
RESULTS = Path(__file__).with_name("results.json")
SAID, SAID_OF_PAPER = "said", "said-of-paper"  # folders
PAPER = ("forward_slow", 0)  # block and repeat: one direction, an offset and 2 to 5 Hz, once in every pose
LEFT_OUT = ("example", "where")  # of a document: large, and nothing that is scored


def prepare(one: Case, folder: Path, *, small: bool = False) -> None:
    """Sweeps and truth of a case, unless they are there; `small`: of a short design."""
    sweeps = folder / "sweeps" / f"{one.number:05}.npz"
    if sweeps.exists():
        return
    robot, joint, measured, truth = make(one, small=small)
    _write(folder / "truth" / f"{one.number:05}.json", truth.document())
    save(sweeps, robot, joint, measured)


def diagnosed(path: Path, *, paper: bool = False) -> dict[str, Any]:
    """What the service says of one file of sweeps, with its seconds of a processor; an exception is told as one."""
    robot, joint, sweeps = load(path)
    if paper:
        sweeps = tuple(sweep for sweep in sweeps if (sweep.spec.block, sweep.spec.repeat) == PAPER)
    before = time.process_time()
    try:
        said: dict[str, Any] = axis_document(diagnose_axis(robot, joint, sweeps)).as_json()
    except Exception as error:  # noqa: BLE001 - whatever breaks off a diagnosis is the outcome of that case
        said = {"error": f"{type(error).__name__}: {error}"}
    said = {key: value for key, value in said.items() if key not in LEFT_OUT}
    said["seconds"] = time.process_time() - before
    return said


def run(one: Case, folder: Path, *, again: bool = False, small: bool = False, paper: bool = False) -> int:
    """Make, diagnose, write down; its number."""
    prepare(one, folder, small=small)
    told = folder / (SAID_OF_PAPER if paper else SAID) / f"{one.number:05}.json"
    if again or not told.exists():
        _write(told, diagnosed(folder / "sweeps" / f"{one.number:05}.npz", paper=paper))
    return one.number


def run_all(wanted: Sequence[Case], folder: Path, processes: int, *, again: bool, paper: bool = False) -> None:
    """All cases, in so many processes of one thread each."""
    os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context, initializer=_end_with_parent) as pool:
        futures = [pool.submit(run, one, folder, again=again, paper=paper) for one in wanted]
        shown = track(as_completed(futures), total=len(futures), description="cases", console=Console(stderr=True))
        for future in shown:
            future.result()


def _end_with_parent() -> None:
    """A worker whose scorer was killed would wait for its next case for ever."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def scores(wanted: Sequence[Case], folder: Path, said_in: str = SAID) -> list[Score]:
    """Truth beside what was said."""
    result: list[Score] = []
    for one in wanted:
        truth, said = (json.loads((folder / f / f"{one.number:05}.json").read_text()) for f in ("truth", said_in))
        result.append(Score(truth, said))
    return result


def _write(path: Path, document: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(document, default=float))
    partial.replace(path)


def _arguments(given: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    for name, text in {
        "singles": "of every effect in every size", "pairs": "", "triples": "", "none": "healthy machines",
        "balanced": "healthy machines with a counterbalance",
        "outside": "effects that the catalogue does not cover", "nominal": "wrong nominals and broken data",
    }.items():  # fmt: skip
        parser.add_argument(f"--{name}", type=int, default=0, help=text)
    parser.add_argument("--small", action="store_true", help="singles of 1 to 2 times the noise as well")
    parser.add_argument("--effects", nargs="+", help="only cases that hide one of these")
    parser.add_argument("--paper", action="store_true", help="also from what the paper measures alone")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--keep", type=Path, help="folder for sweeps, truths and what was said")
    parser.add_argument("--again", action="store_true", help="diagnose what lies in --keep anew")
    parser.add_argument("--json", type=Path, help="the figures as a file")
    parser.add_argument("--write", action="store_true", help="the page and the figures of this run into the project")
    return parser.parse_args(given)


def main(arguments: Sequence[str] | None = None) -> None:
    given = _arguments(arguments)
    wanted = cases(
        given.seed, singles=given.singles, none=given.none, pairs=given.pairs, triples=given.triples,
        outside=given.outside, nominal=given.nominal, balanced=given.balanced,
        sizes=("small", "medium", "large")[not given.small :],
    )  # fmt: skip
    if given.effects:
        wanted = [one for one in wanted if set(given.effects) & set(one.names)]
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.keep or Path(scratch)
        run_all(wanted, folder, given.processes, again=given.again)
        found = scores(wanted, folder)
        alone = [one for one in wanted if one.kind in (Kind.NONE, Kind.SINGLE) and one.size != "small"]
        if given.paper:
            run_all(alone, folder, given.processes, again=given.again, paper=True)
        by_paper = scores(alone, folder, SAID_OF_PAPER) if given.paper else []
    git = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False)
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    told = result(found, by_paper, _command(given), today, git.stdout.strip() or "unknown")
    console = Console()
    console.print(Markdown(page(told)))
    console.print("\n".join(told["failed"]), markup=False, highlight=False)
    for place in [given.json] * bool(given.json) + [RESULTS] * given.write:
        place.write_text(json.dumps(told, indent=2) + "\n")
    if given.write:
        PAGE.write_text(page(told))


def _command(given: argparse.Namespace) -> str:
    counts = " ".join(
        f"--{name} {getattr(given, name)}"
        for name in ("seed", "singles", "pairs", "triples", "none", "balanced", "outside", "nominal")
    )
    flags = "".join(f" --{name}" for name in ("small", "paper") if getattr(given, name))
    return f"python -m tests.numeric.second_plant.score {counts}{flags} --write"


if __name__ == "__main__":
    main(sys.argv[1:])
