"""The score as a page of the documentation."""

import ast
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.numeric.second_plant.scoring import Outcome, Score, confusion, failed, figures, intervals, outcomes
from tests.numeric.tables import count, number, table

Result = dict[str, Any]

ROOT = Path(__file__).parents[3]
SCORED = (
    "service/diagnosis",
    "service/data_check",
    "service/formats/export/started_robot.py",
    "service/identification/design/diagnosis_sweeps.py",
)

ROWS: dict[str, tuple[str, str]] = {
    "right_name": ("right name, medium and large singles, %", ">= 95"),
    "wrong_name": ("wrong name, medium and large singles, %", "<= 2"),
    "truth_admitted": ("truth among names or candidates, medium and large singles, %", ""),
    "called_unknown": ("called unknown, medium and large singles, %", ""),
    "small_wrong": ("small (1 to 2 times the noise): wrong name, %", "<= 3"),
    "false_alarms": ("false alarms on healthy machines, %", "<= 1"),
    "outside_unknown": ("effect outside the catalogue called unknown (tilted base: or gravity error), %", ">= 90"),
    "outside_wrong": ("... given a name, %", ""),
    "pairs_exact": ("pairs named exactly, %", ">= 80"),
    "pairs_wrong": ("pairs: wrong name, %", ""),
    "triples_wrong": ("three at once: wrong name, %", "<= 3"),
    "wrong_in_part": ("a wrong name together with an unknown rest, %", ""),
    "faults_told": ("wrong nominal values and faulty data: fault reported, %", ">= 95"),
    "sound_with_findings": ("sound data with a finding, %", "0"),
    "gap_median": ("gap after / noise floor of named cases, median", "<= 1.1"),
    "gap_95th": ("... 95th percentile", "<= 1.5"),
    "parameters": ("stated parameters that exist in the truth", ""),
    "parameters_within_two_std": ("... truth within two standard deviations, %", "93 to 97"),
    "experiment_proposed": ("neither `none` nor `named`: an experiment is proposed, %", ""),
    "errors": ("ended by an error", "0"),
    "seconds_median": ("processor time per axis, s, median", "<= 5"),
    "seconds_longest": ("... longest", ""),
}


PAPER_ROWS = {
    "wrong_name": "<= 3",
    "truth_admitted": ">= 95",
    "right_name": "",
    "called_unknown": "",
    "false_alarms": "",
    "experiment_proposed": "100",
}


def result(scores: Sequence[Score], by_paper: Sequence[Score], command: str, date: str, commit: str) -> Result:
    """Content of the page as plain data. `by_paper`: scores with the measurements of the paper only; `code`: digest of
    the scored code.
    """
    return {
        "command": command,
        "date": date,
        "commit": commit,
        "code": digest(),
        "figures": figures(scores),
        "paper": figures(by_paper) if by_paper else None,
        "outcomes": outcomes(scores),
        "confusion": confusion(scores),
        "intervals": intervals(scores),
        "failed": failed(scores),
    }


def digest() -> str:
    """Digest of the code of the diagnosis and the data check: what its functions, classes and constants compute.

    Comments, docstrings, layout, imports, and in which file they lie do not count; `__init__.py` has none.
    """
    found: set[bytes] = set()
    files = {path for place in SCORED for path in (ROOT / place, *(ROOT / place).rglob("*.py")) if path.is_file()}
    for path in (path for path in files if path.name != "__init__.py"):
        for statement in ast.parse(path.read_text("utf-8")).body:
            if isinstance(statement, ast.Import | ast.ImportFrom | ast.Expr):
                continue
            nodes = list(ast.walk(statement))
            words = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
            told = [
                f"{type(node).__name__} {[it for _, it in ast.iter_fields(node) if isinstance(it, str | int | float)]}"
                for node in nodes
                if id(node) not in words and not isinstance(node, ast.Import | ast.ImportFrom | ast.alias)
            ]
            found.add(hashlib.sha256("\n".join(told).encode()).digest())
    return hashlib.sha256(b"".join(sorted(found))).hexdigest()[:16]


def page(run: Result) -> str:
    """Markdown."""
    found = run["figures"]
    names = [outcome.value for outcome in Outcome]
    kinds = ", ".join(
        f"{found[f'{kind}_cases']} {kind}" for kind in ("none", "single", "pair", "triple", "outside", "nominal")
    )
    lines = [
        "# How well a diagnosis names hidden effects",
        "",
        "The scores are measured on machines that share no formula with the service or its simulator",
        "(`tests/numeric/second_plant`): random robots in MuJoCo, CAD errors of 10 to 18 % with a prior of 30 % in",
        "three quarters of the cases, friction that sticks, coloured noise, and laws from the literature that are not",
        "in the catalogue. What is missed, and why: [diagnosis](../explanation/diagnosis.md).",
        "",
        "A case is right if every hidden effect is named, and nothing else except its physical consequences; an effect",
        "outside the catalogue must be `unknown`; a fault in the data must be a finding. `payload` and",
        "`torque_constant_error` count as right if they are called ambiguous and a test mass is requested. Small: 1 to",
        "2 times the noise; medium: 1.5 to 3 % of the rated effort; large: 3 to 8 %.",
        "",
        f"Cases: {kinds}. Date {run['date']}, commit {run['commit']}. Command:",
        "",
        "```",
        run["command"],
        "```",
        "",
        *table(("", "measured", "target"), [(text, number(found[key]), goal) for key, (text, goal) in _present(found)]),
        "",
        *_paper(run["paper"]),
        "Outcomes by class:",
        "",
        *table(("class", *names), _rows(run["outcomes"], names)),
        "",
        "Result for each hidden effect, wrong names first:",
        "",
        *table(("hidden", "result"), [(hidden, _said(counts)) for hidden, counts in run["confusion"].items()]),
        "",
        "True parameters within two standard deviations:",
        "",
        *table(
            ("parameter", "stated", "within"),
            [(name, str(one["stated"]), str(one["two"])) for name, one in run["intervals"].items()],
        ),
        "",
    ]
    return "\n".join(lines)


def _paper(found: Mapping[str, Any] | None) -> list[str]:
    if found is None:
        return []
    cases = f"{found['none_cases']} healthy machines and {found['big_cases']} medium and large singles"
    rows = [(ROWS[key][0], number(found[key]), goal) for key, goal in PAPER_ROWS.items()]
    return [
        f"Measurements of the paper only (one direction, an offset and 2 to 5 Hz, once in every pose), {cases}:",
        "",
        *table(("", "measured", "target"), rows),
        "",
    ]


def _present(found: Mapping[str, Any]) -> list[tuple[str, tuple[str, str]]]:
    return [(key, row) for key, row in ROWS.items() if found[key] is not None]


def _rows(counted: Mapping[str, Mapping[str, int]], columns: Sequence[str]) -> list[tuple[str, ...]]:
    return [(name, *(count(counts.get(column, 0)) for column in columns)) for name, counts in counted.items()]


def _said(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {many}" for name, many in sorted(counts.items(), key=lambda item: -item[1]))
