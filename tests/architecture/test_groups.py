"""How `make test` shares its files out to processes: what the scheduler really does."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import KEEP_TIME_TOO, LONGEST, SHARED_OUT, keeps_time, unit_of

pytestmark = pytest.mark.slow

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
    ("nodeid", "it_does"),
    [
        ("tests/contract/test_faults.py::test_a[canopen-a/b]", True),
        ("tests/system/test_rest_death.py", True),
        ("tests/unit/drivers/test_host_sweep.py::test_a", True),
        ("tests/unit/drivers/test_stop_sequence.py::test_a[system]", False),
    ],
)
def test_what_keeps_to_time_is_known(nodeid: str, it_does: bool) -> None:
    assert keeps_time(nodeid) is it_does


@pytest.mark.parametrize(
    ("nodeid", "unit"),
    [
        ("tests/unit/drivers/test_states.py::test_a[b]", "tests/unit/drivers/test_states.py"),
        (
            "tests/contract/test_faults.py::TestFaults::test_a[modbus-tcp-drive_side]",
            "tests/contract/test_faults.py::[modbus-tcp]",
        ),
        (
            "tests/system/test_fault_table.py::test_a[CANopen, drive's own sweep-silent node]",
            "tests/system/test_fault_table.py::[CANopen, drive's own sweep]",
        ),
        ("tests/system/test_stop.py::test_a[canopen-b]", "tests/system/test_stop.py::test_a[canopen-b]"),
    ],
)
def test_long_files_are_shared_out_by_machine_or_by_test(nodeid: str, unit: str) -> None:
    assert unit_of(nodeid) == unit


def test_tests_that_share_a_machine_are_not_shared_out_one_by_one(root: Path) -> None:
    alone = [file for file, words in SHARED_OUT.items() if words == 0]
    assert [file for file in alone if 'scope="module"' in (root / file).read_text("utf-8")] == []


def test_the_files_that_are_named_are_there(root: Path) -> None:
    assert [file for file in sorted({*KEEP_TIME_TOO, *LONGEST, *SHARED_OUT}) if not (root / file).is_file()] == []


@pytest.mark.slow
def test_what_keeps_to_time_starts_first(root: Path) -> None:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST_")}
    files = ("tests/unit/drivers/test_states.py", "tests/unit/drivers/test_host_sweep_ends.py")
    command = [sys.executable, "-m", "pytest", "-n", "1", "--dist", "loadscope", "-v", "--color=no"]
    command += ["-p", "no:cacheprovider", *files]
    run = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, timeout=120, check=True)
    ran = re.findall(r"^\[gw\d\].* PASSED (\S+?)::", run.stdout, re.MULTILINE)
    assert list(dict.fromkeys(ran)) == list(reversed(files))
