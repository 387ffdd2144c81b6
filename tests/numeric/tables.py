"""Tables of Markdown for the pages that scorers write."""

from collections.abc import Sequence


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines; the first column to the left, the others to the right."""
    line = "|" + "|".join([" --- ", *[" ---: "] * (len(head) - 1)]) + "|"
    return [_row(head), line, *map(_row, rows)]


def count(value: int) -> str:
    return str(value) if value else ""


def number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.4g}" if value >= 100 else f"{value:.3g}"


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
