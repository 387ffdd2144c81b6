"""The processes of `make test` do not tear a group of tests apart: what the scheduler really does."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import BESIDE, group_of

TWO_FILES = ("tests/unit/drivers/test_stop_sequence.py", "tests/unit/drivers/test_states.py")


@pytest.mark.slow
def test_each_file_runs_in_one_process(root: Path) -> None:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST_")}
    command = [sys.executable, "-m", "pytest", "-n", "2", "--dist", "loadscope", "-v", "--color=no"]
    command += ["-p", "no:cacheprovider", *TWO_FILES]
    run = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, timeout=120, check=True)
    ran = re.findall(r"^\[(gw\d)\].* PASSED (\S+?)::", run.stdout, re.MULTILINE)
    assert {file for _, file in ran} == set(TWO_FILES)
    assert len(set(ran)) == len(TWO_FILES)


@pytest.mark.parametrize(
    ("nodeid", "group"),
    [
        ("tests/contract/test_faults.py::test_a[canopen-a/b]", "drives"),
        ("tests/system/test_rest_death.py::test_a", "machines"),
        ("tests/system/test_demo.py::test_a", "drives"),
        ("tests/unit/drivers/test_stop_sequence.py::test_a[system]", "tests/unit/drivers/test_stop_sequence.py"),
    ],
)
def test_what_moves_machines_is_one_group(nodeid: str, group: str) -> None:
    assert group_of(nodeid) == group


def test_the_files_that_are_named_are_there(root: Path) -> None:
    assert [file for file in sorted(BESIDE) if not (root / file).is_file()] == []


def test_what_keeps_to_time_starts_first(root: Path) -> None:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST_")}
    files = ("tests/unit/drivers/test_states.py", "tests/unit/drivers/test_host_sweep_ends.py")
    command = [sys.executable, "-m", "pytest", "-n", "1", "--dist", "loadscope", "-v", "--color=no"]
    command += ["-p", "no:cacheprovider", *files]
    run = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, timeout=120, check=True)
    ran = re.findall(r"^\[gw\d\].* PASSED (\S+?)::", run.stdout, re.MULTILINE)
    assert list(dict.fromkeys(ran)) == list(reversed(files))
