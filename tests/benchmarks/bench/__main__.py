"""``make bench``: everything, beside what else could do it, as JSON and as docs/reference/benchmarks.md.

    python -m tests.benchmarks.bench [--only NAME ...] [--quick] [--json FILE]

`--only` measures these again and keeps the others' results. `--quick` prints the ratios of the short form alone, or
writes them to a file, and leaves results and page as they are. `--page` writes the page anew, without measuring.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import Any

from tests.benchmarks.bench.computer import computer
from tests.benchmarks.bench.measured import Measured
from tests.benchmarks.bench.page import page
from tests.benchmarks.bench.texts import TITLES

RESULTS = Path(__file__).parents[1] / "results" / "bench.json"
PAGE = Path(__file__).parents[3] / "docs" / "reference" / "benchmarks.md"
SHORT = ("selection", "rows", "plant", "revisions")


def measure(name: str) -> dict[str, Any]:
    """One benchmark."""
    before, began = os.getloadavg()[0], time.process_time()
    rows = [_told(row) for row in _benchmark(name, "run")()]
    return {
        "at": datetime.now(UTC).isoformat(timespec="minutes"),
        "load": [before, os.getloadavg()[0]],
        "processor": time.process_time() - began,
        "rows": rows,
    }


def short() -> dict[str, Any]:
    """The ratios that are robust, by name."""
    rows = [_told(row) for name in SHORT for row in _benchmark(name, "quick")()]
    return {row["name"]: {key: row[key] for key in ("ratio", "ours", "peer", "unit", "beside")} for row in rows}


def _benchmark(name: str, form: str) -> Callable[[], Iterator[Measured]]:
    return getattr(import_module(f"tests.benchmarks.bench.{name}"), form)


def _told(row: Measured) -> dict[str, Any]:
    ratio = "" if row.ratio is None else f", {row.ratio:.3g} x {row.beside}"
    met = {True: ", met", False: ", MISSED", None: ""}[row.met]
    print(f"{row.name}: {row.ours:.4g} {row.unit}{ratio}{met}", flush=True)
    return asdict(row) | {"ratio": row.ratio}


def keep(section: str, name: str, found: object) -> None:
    """Put it into the results file beside what is there."""
    results: dict[str, Any] = json.loads(RESULTS.read_text("utf-8")) if RESULTS.exists() else {}
    results["computer"] = computer()
    if name:
        results.setdefault(section, {})[name] = found
    else:
        results[section] = found
    RESULTS.write_text(json.dumps(results, indent=1) + "\n", "utf-8")


def everything(names: Sequence[str]) -> None:
    """Measure these and keep each."""
    for name in names:
        if name == "short":
            keep("short", "", short())
        elif name == "profiles":
            found = import_module("tests.benchmarks.bench.profiles").profiles()
            keep("profiles", "", [asdict(each) for each in found])
        else:
            keep("benchmarks", name, measure(name))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=[*TITLES, "short", "profiles"], help="of the benchmarks")
    parser.add_argument("--quick", action="store_true", help="the short form alone")
    parser.add_argument("--page", action="store_true", help="write the page from the results there are")
    parser.add_argument("--json", type=Path, help="file for the short form")
    options = parser.parse_args()
    if options.quick:
        found = short()
        if options.json:
            options.json.write_text(json.dumps(found, indent=1) + "\n", "utf-8")
        return 0
    if not options.page:
        everything(options.only or [*TITLES, "short", "profiles"])
    PAGE.write_text(page(json.loads(RESULTS.read_text("utf-8"))), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
