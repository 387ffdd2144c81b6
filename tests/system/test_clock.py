"""The clock that the soak sets: its processes see it, and what only counts on goes on."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.system.clock import Clock

SEEN = """
import sqlite3, sys, time
for _ in sys.stdin:
    (julian,) = sqlite3.connect(":memory:").execute("SELECT julianday('now')").fetchone()
    print(time.time(), (julian - 2440587.5) * 86400, time.monotonic(), flush=True)
"""


@pytest.mark.parametrize("seconds", [3600.0, -86400.5])
def test_a_process_and_its_database_see_the_clock_set(tmp_path: Path, seconds: float) -> None:
    clock = Clock(tmp_path)
    command = [sys.executable, "-c", SEEN]
    environment = os.environ | clock.environment
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment) as seen:
        assert seen.stdin
        assert seen.stdout
        for ahead in (0.0, seconds):
            clock.step(ahead)
            before, counted = time.time(), time.monotonic()
            seen.stdin.write("\n")
            seen.stdin.flush()
            wall, database, monotonic = (float(word) for word in seen.stdout.readline().split())
            after = time.time()
            assert before + ahead - 1e-3 <= wall <= after + ahead + 1e-3
            assert before + ahead - 2e-3 <= database <= after + ahead + 2e-3
            assert counted <= monotonic <= time.monotonic()
        seen.stdin.close()
