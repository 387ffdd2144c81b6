"""The short form of the workers' soak: 1,500 jobs. The long run is by hand."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.programs import needs
from tests.soak.workers import MOST_GROWTH, WARM

TASKS = WARM + 1000


@pytest.mark.slow
@needs("openssl")
def test_no_process_grows_with_the_jobs_that_it_has_done(tmp_path: Path, root: Path) -> None:
    """In a process of its own: how much this one grows depends on the tests before."""
    result = tmp_path / "result.json"
    command = [sys.executable, "-m", "tests.soak.workers", "--tasks", str(TASKS), "--result", str(result)]
    subprocess.run(command, cwd=root, check=True)
    growth = json.loads(result.read_text("utf-8"))["growth_mib"]
    assert set(growth) == {"scheduler", "worker 1", "worker 2", "service"}
    assert {name: grown for name, grown in growth.items() if grown > MOST_GROWTH} == {}
