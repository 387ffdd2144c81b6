"""No ratio of the benchmarks' short form is much worse than the page says."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = "docs/reference/benchmarks.md"
WORSE = 0.50  # on another processor, whose vector units do not help both sides alike
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
MEASURE = """
import json
from docs.benchmarks.__main__ import short
print(json.dumps({each.name: each.ratio for each in short()}))
"""


def measured(root: Path) -> dict[str, float]:
    """In a process of its own: one thread, nothing else in its time."""
    command = [sys.executable, "-c", MEASURE]
    done = subprocess.run(
        command, cwd=root, env=os.environ | ONE_THREAD, check=True, timeout=600, capture_output=True, text=True
    )
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.slow
def test_no_ratio_is_much_worse(root: Path) -> None:
    page = (root / PAGE).read_text("utf-8").partition("<!-- short -->")[2].partition("<!-- end of short -->")[0]
    told = {name: float(ratio) for name, ratio in re.findall(r"^\| (.+?) \| .+? \| ([\d.]+) \|$", page, re.MULTILINE)}
    best = measured(root)
    assert told.keys() == best.keys(), "run: make bench BENCH='--only short'"
    least = {name: (1 - WORSE) * ratio for name, ratio in told.items()}
    if any(best[name] < ratio for name, ratio in least.items()):  # once more before it is believed: the better counts
        again = measured(root)
        best = {name: max(ratio, again[name]) for name, ratio in best.items()}
    assert {name: (ratio, told[name]) for name, ratio in best.items() if ratio < least[name]} == {}
