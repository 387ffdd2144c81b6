"""A test process that dies costs the test that it ran, and not the run: the others go on to the end."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

_CONFTEST = """
from xdist.scheduler import LoadScopeScheduling
from tests.conftest import MachinesAtOnce


def pytest_xdist_make_scheduler(config, log):
    return MachinesAtOnce(config, log)
"""
_DIES = "import os\n\n\ndef test_dies():\n    os._exit(1)\n"
_PASSES = "def test_passes():\n    pass\n"


@pytest.mark.slow
@pytest.mark.parametrize("dying", [0, 3, 5])
def test_the_others_go_on(tmp_path: Path, root: Path, dying: int) -> None:
    (tmp_path / "conftest.py").write_text(_CONFTEST)
    for number in range(6):
        (tmp_path / f"test_{number}.py").write_text(_DIES if number == dying else _PASSES)
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST_")}
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-n",
            "2",
            "--max-worker-restart",
            "2",
            "-p",
            "no:cacheprovider",
            str(tmp_path),
        ],
        cwd=root,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert "5 passed" in done.stdout, done.stdout + done.stderr
    assert "crashed while running '" in done.stdout
    assert "1 failed" in done.stdout
