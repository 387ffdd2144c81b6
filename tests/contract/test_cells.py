"""The table of cells in docs/reference/foreign-drives.md is what pytest collects."""

import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

from tests.contract.bench import BENCHES, Bench

ROWS = {
    "own map of the virtual drive": "canopen",
    "plain 402": "plain",
    "EPOS4": "epos4",
    "Gold": "gold",
    "SimplIQ": "simpliq",
    "Powerball": "powerball",
    "durand, 60FFh": "durand",
    "node-canopen, 60FFh": "node",
    "node-canopen, 607Ah": "node-csp",
    "virtual drive": "modbus",
}
COLUMNS = {"virtual drive": ("tcp", "rtu")}
BUSES = ("virtual", "socketcand", "vcan")


def collected(root: Path, *options: str) -> Counter[str]:
    """Tests of each bench."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "--every-drive", *options, "tests/contract"]
    run = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    longest = sorted(BENCHES, key=len, reverse=True)
    names = re.compile(rf"\[({'|'.join(longest)})(?=[-\]])")
    return Counter(found[1] for line in run.stdout.splitlines() if (found := names.search(line)))


def target(bench: Bench) -> str:
    return "D" if bench.alike else "V" if bench.vcan else "T"


def test_the_table_of_cells_is_what_pytest_collects(root: Path) -> None:
    page = (root / "docs/reference/foreign-drives.md").read_text("utf-8").partition("## Which test runs where")[2]
    told: dict[str, str] = {}
    for title, prefix in ROWS.items():
        row = re.search(rf"^\| {re.escape(title)} \|(.+)\|$", page, re.MULTILINE)
        assert row is not None, title
        for column, cell in zip(COLUMNS.get(title, BUSES), row[1].split("|"), strict=True):
            if cell.strip():
                told[f"{prefix}-{column}"] = cell.strip()
    counts = collected(root) + collected(root, "--vcan")
    assert told == {name: f"{counts[name]} {target(bench)}" for name, bench in BENCHES.items()}
