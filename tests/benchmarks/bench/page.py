"""Results -> docs/reference/benchmarks.md."""

from collections.abc import Mapping, Sequence
from typing import Any

from tests.benchmarks.bench.texts import REMARKS, TEXT, TITLES

Cells = Sequence[str]
HEAD = ("what", "ours", "compared with", "peer or limit", "times better", "repeats", "spread", "target", "met")


def page(results: Mapping[str, Any]) -> str:
    """The whole page, from a results file."""
    computer = results["computer"]
    loads = [load for each in results["benchmarks"].values() for load in each["load"]]
    parts = [
        TEXT.format(**computer, least_load=min(loads), most_load=max(loads)),
        *(_section(name, results["benchmarks"][name]) for name in TITLES if name in results["benchmarks"]),
        _missed(results["benchmarks"]),
        *([_profiles(results["profiles"])] if "profiles" in results else []),
        *([_short(results["short"])] if "short" in results else []),
    ]
    return "\n".join(parts)


def number(value: float) -> str:
    """Three digits, with a separator for thousands."""
    if value >= 1000:
        return f"{float(f'{value:.3g}'):,.0f}"
    return f"{value:.3g}"


def _section(name: str, found: Mapping[str, Any]) -> str:
    rows = found["rows"]
    text = f"## {TITLES[name]}\n\n{REMARKS.get(name, '')}\n\n" if name in REMARKS else f"## {TITLES[name]}\n\n"
    if name == "growth":
        table = _table(
            ("cost", "exponent", "processor time"), [(r["name"], number(r["ours"]), r["note"]) for r in rows]
        )
    else:
        notes = [f"- {row['name']}: {row['note']}" for row in rows if row["note"]]
        table = _table(HEAD, [_row(row) for row in rows]) + ("\n" + "\n".join(notes) + "\n" if notes else "")
    load = ", ".join(f"{each:.1f}" for each in found["load"])
    return f"{text}{table}\nLoad average before and after: {load}; {found['processor']:.0f} s of processor time.\n"


def _row(row: Mapping[str, Any]) -> Cells:
    unit = row["unit"]
    peer = "" if row["peer"] is None else f"{number(row['peer'])} {unit}"
    ratio = "" if row["ratio"] is None else number(row["ratio"])
    spread = f"{100 * row['spread']:.0f} %" if row["spread"] else ""
    met = {True: "yes", False: "**no**", None: ""}[row["met"]]
    ours = f"{number(row['ours'])} {unit}"
    return row["name"], ours, row["beside"], peer, ratio, str(row["repeats"]), spread, row["target"], met


def _missed(benchmarks: Mapping[str, Any]) -> str:
    missed = [row["name"] for each in benchmarks.values() for row in each["rows"] if row["met"] is False]
    names = "\n".join(f"- {name}" for name in missed) if missed else "None."
    return f"## Targets that are missed\n\n{names}\n\n{REMARKS['missed']}\n"


def _profiles(profiles: Sequence[Mapping[str, Any]]) -> str:
    parts = [f"## Where the time goes\n\n{REMARKS['profiles']}\n"]
    for each in profiles:
        rows = [
            (f"`{x['function']}`", f"{x['calls']:,}", f"{x['own']:.2f}", f"{x['whole']:.2f}") for x in each["lines"]
        ]
        table = _table(("function", "calls", "s, own", "s with callees"), rows)
        parts.append(
            f"### {each['path'].capitalize()}: {each['processor']:.2f} s\n\n{table}\n{REMARKS[each['path']]}\n"
        )
    return "\n".join(parts)


def _short(short: Mapping[str, Any]) -> str:
    rows = [(name, each["beside"], number(each["ratio"])) for name, each in short.items()]
    return f"## The short form\n\n{REMARKS['short']}\n\n{_table(('what', 'compared with', 'times better'), rows)}"


def _table(head: Cells, rows: Sequence[Cells]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)
