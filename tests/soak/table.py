"""What the runs of the soak found, summed up: ``python -m tests.soak.table`` writes docs/reference/soak.md.

A run leaves its figures with ``--json tests/soak/results/WAY-SEED.json``; `tests.soak.plant` leaves `plant.json`,
`tests.soak.workers` `dask-workers.json`.
"""

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from pydantic import BaseModel

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "soak.md"
RESULTS = Path(__file__).parent / "results"
WAYS = ("canopen", "canopen-streamed", "modbus")
WANTED = 20  # times each
_HEAD = f"""# Soak: what was disturbed, how often, and what was lost

Written by `python -m tests.soak.table` from the runs in `tests/soak/results`; every number is measured,
only the remarks are written by hand.
`make soak` disturbs real campaigns of a virtual machine at random moments in a random order, with the service, its
worker and its stop process as processes of their own. A watch sees each axis 50 times a second and what leave it has.
Promised: no axis moves unasked, each sweep is identified once, by one complete recording and with one revision, and at
most 100 ms of the samples that a drive had measured are in no recording. {WANTED} times each are wanted.
"""


class Times(BaseModel):
    """Of one disturbance; `ended`: of these the run was ended."""

    times: int
    ended: int


class Rest(BaseModel):
    """s of the machine's clock until the axes stood."""

    median: float
    longest: float


class Result(BaseModel):
    """A run, as `tests.soak` writes it. `lost_ms`: most samples of a drive's own sweep that no recording has."""

    way: str
    seed: int
    at: str
    disturbances: dict[str, Times]
    moved_unasked: list[str]
    broken: list[str]
    campaigns: int
    sweeps: int
    attempts: int
    lost_ms: dict[str, float]
    to_rest_s: Rest
    unplanned: list[str]
    remarks: list[str] = []
    """What a reader of this run's figures must know, written by hand."""


class PlantResult(BaseModel):
    """One campaign whose plant was killed in parts, as `tests.soak.plant` writes it."""

    sweeps: int
    seed: int
    seconds: float
    load: float
    disturbances: dict[str, int]
    not_identified: list[int]
    without_revision: list[int]
    counted_twice: list[int]
    attempts: int
    largest_difference: float


class WorkersResult(BaseModel):
    """Many jobs, as `tests.soak.workers` writes it."""

    tasks: int
    seconds: float
    load: float
    growth_mib: dict[str, float]
    most_mib: float
    looks: list[dict[str, float]]
    """Resident memory by process, MiB, and the `tasks` done by then."""


def results(folder: Path = RESULTS) -> list[Result]:
    paths = sorted(path for way in WAYS for path in folder.glob(f"{way}-[0-9]*.json"))
    return [Result.model_validate(json.loads(path.read_text("utf-8"))) for path in paths]


def plant(folder: Path = RESULTS) -> str:
    """The section of the plant: PostgreSQL, object store, scheduler and workers."""
    run = PlantResult.model_validate(json.loads((folder / "plant.json").read_text("utf-8")))
    jobs = WorkersResult.model_validate(json.loads((folder / "dask-workers.json").read_text("utf-8")))
    rows = [["", "campaign"]]
    rows += [[name.replace("_", " "), str(times)] for name, times in sorted(run.disturbances.items())]
    rows += [
        ["sweeps", str(run.sweeps)],
        ["attempts at them", str(run.attempts)],
        ["**sweeps not identified**", str(len(run.not_identified))],
        ["**sweeps without a revision**", str(len(run.without_revision))],
        ["**sweeps counted twice**", str(len(run.counted_twice))],
        ["largest relative difference of the last estimate from the undisturbed one", f"{run.largest_difference:.1g}"],
    ]
    third = jobs.looks[len(jobs.looks) // 3]
    grown = [
        [name, f"{mib:+.1f}", f"{jobs.looks[-1][name] - third[name]:+.1f}"] for name, mib in jobs.growth_mib.items()
    ]
    return "\n".join(
        [
            "## A plant",
            "",
            "`python -m tests.soak.plant`: one campaign with PostgreSQL, an S3 store (moto) and four Dask workers with",
            "TLS, of which parts are killed, restarted or cut off at random moments."
            f" Seed {run.seed}, {run.seconds:.0f} s, load {run.load:.0f}.",
            "",
            *_table(rows),
            "",
            f"`python -m tests.soak.workers`: {jobs.tasks} jobs through a scheduler and two workers in"
            f" {jobs.seconds:.0f} s, load {jobs.load:.0f}.",
            f"Wanted: after the first {jobs.looks[0]['tasks']:.0f} jobs no process grows by more than"
            f" {jobs.most_mib:.0f} MiB.",
            "",
            *_table(
                [
                    [
                        "growth of the resident memory, MiB",
                        f"from {jobs.looks[0]['tasks']:.0f} jobs on",
                        f"from {third['tasks']:.0f} jobs on",
                    ],
                    *grown,
                ]
            ),
            "",
        ]
    )


def page(runs: Sequence[Result]) -> str:
    """Two tables: each disturbance by way, and each way as a whole."""
    ways = [way for way in WAYS if any(run.way == way for run in runs)]
    of = {way: [run for run in runs if run.way == way] for way in ways}
    names = sorted({name for run in runs for name in run.disturbances}, key=str.lower)
    each = [["disturbance", *(f"{way}: {what}" for way in ways for what in ("times", "run ended", "most lost, ms"))]]
    each += [[name, *(cell for way in ways for cell in _cells(of[way], name))] for name in names]
    whole = [["", *ways]]
    whole += [[label, *(str(figure(of[way])) for way in ways)] for label, figure in _WHOLE.items()]
    remarks = [f"- {run.way}, seed {run.seed}: {remark}" for run in runs for remark in run.remarks]
    parts = [_HEAD, "## Each disturbance", "", *_table(each), "", "## All of it", "", *_table(whole), ""]
    return "\n".join([*parts, *(["## Remarks", "", *remarks, ""] if remarks else [])])


def whole_page() -> str:
    return page(results()) + "\n" + plant()


def _cells(runs: Sequence[Result], name: str) -> tuple[str, str, str]:
    done = [run.disturbances[name] for run in runs if name in run.disturbances]
    if not done:
        return "–", "–", "–"
    lost = [run.lost_ms[name] for run in runs if name in run.lost_ms]
    told = f"{max(lost):.0f}" if lost else "–"  # it never fell into a sweep that a drive made by itself
    return str(sum(one.times for one in done)), str(sum(one.ended for one in done)), told


def _fewest(runs: Sequence[Result]) -> int:
    count: Counter[str] = Counter()
    for run in runs:
        count.update({name: one.times for name, one in run.disturbances.items()})
    return min(count.values())


_WHOLE = {
    "runs": len,
    "disturbances": lambda runs: sum(one.times for run in runs for one in run.disturbances.values()),
    "fewest of one kind": _fewest,
    "**motions unasked**": lambda runs: sum(len(run.moved_unasked) for run in runs),
    "**campaigns with a sweep lost or counted twice**": lambda runs: sum(len(run.broken) for run in runs),
    "campaigns": lambda runs: sum(run.campaigns for run in runs),
    "sweeps, each identified once": lambda runs: sum(run.sweeps for run in runs),
    "attempts at them": lambda runs: sum(run.attempts for run in runs),
    "longest way to rest, s of the machine's clock": lambda runs: f"{max(run.to_rest_s.longest for run in runs):.1f}",
    "pauses that came a while after a disturbance": lambda runs: sum(len(run.unplanned) for run in runs),
}


def _table(rows: Iterable[Sequence[str]]) -> list[str]:
    first, *rest = rows
    lines = [f"| {' | '.join(row)} |" for row in rest]
    return [f"| {' | '.join(first)} |", f"|{' --- |' * len(first)}", *lines]


if __name__ == "__main__":
    PAGE.write_text(whole_page(), "utf-8")
