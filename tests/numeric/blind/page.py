"""The figures as a page of the documentation."""

from collections.abc import Mapping, Sequence

from tests.numeric.blind.effects import CATALOGUE
from tests.numeric.blind.scoring import Outcome, Score, confusion, figures, outcomes

VERDICTS = ("none", "untestable", "ambiguous", "unknown")

ROWS = {
    "right_name": ("right name", ">= 95 %"),
    "right_after_experiments": ("right name after the experiments asked for", ">= 90 %"),
    "right_after_test_mass": ("... of those that need a test mass", ""),
    "in_tie_set": ("truth in the tie-set", ">= 98 %"),
    "wrong_name": ("wrong name, or one too many", "<= 2 %"),
    "called_unknown": ("catalogue effect called unknown", "<= 4 %"),
    "false_alarms": ("false alarms", "0"),
    "outside_unknown": ("effect outside the catalogue called unknown", ">= 92 %"),
    "pairs_exact": ("pairs named exactly", ">= 80 %"),
    "gap_over_noise_floor": ("held-out gap after / noise floor, median", "<= 1.1"),
    "parameters_within_two_std": ("true parameter within two standard deviations", ""),
    "parameters_within_three_std": ("within three", ""),
    "seconds_median": ("seconds an axis, median", "<= 5"),
    "seconds_longest": ("longest", ""),
}


def page(scores: Sequence[Score], command: str) -> str:
    """Markdown: figures, outcomes of every hidden effect, confusion matrix."""
    result = figures(scores)
    counts = ", ".join(f"{result[f'{kind}_cases']} {kind}" for kind in ("single", "pair", "none", "outside"))
    return "\n".join(
        [
            "# How well a diagnosis names hidden effects",
            "",
            "Effects hidden in randomised virtual machines, by physics richer than the catalogue's columns; the",
            f"diagnosis sees recordings only. Cases: {counts}. `payload` and `torque_constant_error` count as right",
            "when they are called ambiguous and a test mass is asked for. Written by:",
            "",
            "```",
            command,
            "```",
            "",
            "## Figures",
            "",
            *_table(
                ("", "measured", "wanted"), [(text, _number(result[key]), aim) for key, (text, aim) in ROWS.items()]
            ),
            "",
            "## What came of each",
            "",
            "Right: named, all of it and nothing else (outside the catalogue: unknown). Tie: ambiguous, the truth one",
            "of the candidates. Part, more: not all of it, or something besides. Wrong: something that is not there.",
            "",
            *_table(("hidden", *(o.value for o in Outcome)), _counted(outcomes(scores), [o.value for o in Outcome])),
            "",
            "## Confusion matrix",
            "",
            "Rows: hidden. Columns: said; numbers are those of the effects in the first column.",
            "",
            *_confusion(scores),
            "",
        ]
    )


def _confusion(scores: Sequence[Score]) -> list[str]:
    names = list(CATALOGUE)
    table = confusion(scores)
    rows = [
        (
            f"{names.index(name) + 1} {name}" if name in names else name,
            *(_count(counts[key]) for key in (*names, *VERDICTS)),
        )
        for name, counts in table.items()
    ]
    return _table(("hidden", *(str(k + 1) for k in range(len(names))), *VERDICTS), rows)


def _counted(table: Mapping[str, Mapping[str, int]], columns: Sequence[str]) -> list[tuple[str, ...]]:
    return [(name, *(_count(counts.get(column, 0)) for column in columns)) for name, counts in table.items()]


def _count(value: int) -> str:
    return str(value) if value else ""


def _number(value: float | int | None) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.3g}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    line = "|" + "|".join([" --- ", *[" ---: "] * (len(head) - 1)]) + "|"
    return [_row(head), line, *map(_row, rows)]


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
