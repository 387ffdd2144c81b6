"""``make bench``: what sweepid costs, beside what else could do it; writes docs/reference/benchmarks.md.

    python -m docs.benchmarks [--only NAME ...]

Each benchmark is a module with `run()`; its table on the page stands between two comments and is replaced, the rest of
the page is written by hand. `short`: the ratios of every `quick()`, which a test measures again.
"""

import argparse
import os
import platform
import re
import time
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import psutil

from docs.benchmarks.measured import Measured

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/reference/benchmarks.md"
NAMES = ("planning", "identification", "peer_estimators", "plant", "wire", "service", "stop", "help")
SHORT = ("planning", "identification", "plant", "help")
PACKAGES = ("numpy", "scipy", "mujoco-core", "pin", "python-can", "fastapi", "uvicorn", "pyarrow")
HEAD = ("what", "ours (repeats, spread)", "peer or limit", "times better", "target; note")


def short() -> Iterator[Measured]:
    """The ratios that hardly depend on the load of the computer."""
    for name in SHORT:
        yield from import_module(f"docs.benchmarks.{name}").quick()


def number(value: float) -> str:
    """Three digits, with a separator for thousands."""
    return f"{float(f'{value:.3g}'):,.0f}" if value >= 1000 else f"{value:.3g}"


def row(found: Measured) -> Sequence[str]:
    peer = "" if found.peer is None else f"{number(found.peer)} {found.unit}: {found.beside}"
    ratio = "" if found.ratio is None else number(found.ratio)
    spread = f", {100 * found.spread:.0f} %" if found.spread else ""
    met = {True: ": met", False: ": **missed**", None: ""}[found.met]
    ours = f"{number(found.ours)} {found.unit} ({found.repeats}{spread})"
    return found.name, ours, peer, ratio, "; ".join(filter(None, (f"{found.target}{met}", found.note)))


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(cells)} |" for cells in (head, *rows)]
    return "\n".join([lines[0], f"|{'---|' * len(head)}", *lines[1:], ""])


def section(name: str) -> str:
    """One benchmark, measured now."""
    if name == "peer_estimators":
        head, *answers = import_module("docs.benchmarks.peer_estimators").rows()
        return f"{table(head, answers)}\n{datetime.now(UTC):%Y-%m-%d}.\n"
    before, began, rows = os.getloadavg()[0], time.process_time(), list[Measured]()
    for found in short() if name == "short" else import_module(f"docs.benchmarks.{name}").run():
        rows.append(found)
        print(" | ".join(row(found)), flush=True)
    if name == "short":
        cells = [(each.name, each.beside, number(each.ratio or 0.0)) for each in rows]
        return table(("what", "compared with", "times better"), cells)
    load = f"load average before and after {before:.1f}, {os.getloadavg()[0]:.1f}"
    spent = f"{time.process_time() - began:.0f} s of processor time"
    return f"{table(HEAD, list(map(row, rows)))}\n{datetime.now(UTC):%Y-%m-%d}; {load}; {spent}.\n"


def computer() -> str:
    """What matters for speed; no name of the computer."""
    return (
        f"{os.cpu_count()} shared cores of a virtual server, {processor()}, "
        f"{round(psutil.virtual_memory().total / 2**30)} GiB, {platform.system()} {platform.release()}; "
        f"Python {platform.python_version()};\n{', '.join(f'{name} {version(name)}' for name in PACKAGES)}.\n"
        f"Threads per call of linear algebra: {os.environ.get('OMP_NUM_THREADS', 'as many as there are')}.\n"
    )


def processor() -> str:
    info = Path("/proc/cpuinfo")
    names = re.findall(r"^model name\s*:\s*(.+)$", info.read_text("utf-8") if info.exists() else "", re.MULTILINE)
    return names[0] if names else platform.machine()


def replaced(page: str, name: str, by: str) -> str:
    """The page with another text between the comments of this name."""
    begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->\n"
    before, _, rest = page.partition(begin)
    _, there, after = rest.partition(end)
    if not there:
        raise ValueError(f"{PAGE}: has no {begin.strip()} with its end")
    return f"{before}{begin}\n{by}\n{end}{after}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", nargs="+", choices=[*NAMES, "short"], help="of the benchmarks")
    for name in parser.parse_args().only or [*NAMES, "short"]:
        print(f"-- {name}", flush=True)
        by = section(name)  # takes minutes: another may write the page meanwhile
        page = replaced(PAGE.read_text("utf-8"), name, by)
        PAGE.write_text(replaced(page, "computer", computer()), "utf-8")


if __name__ == "__main__":
    main()
