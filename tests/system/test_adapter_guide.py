"""Whoever follows the guide to a drive adapter has one that passes the contract suite; and the suite bites."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.guide import written


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The guide's files in `toy-drive`, and its adapter installed in `packages` beside it."""
    desk = tmp_path_factory.mktemp("adapter")
    install, _ = written("write-a-drive-adapter.md", desk / "toy-drive")
    done = run(install.replace("pip install", "-m pip install --no-index --target packages"), desk)
    assert done.returncode == 0, done.stderr
    return desk / "packages"


def run(arguments: str, desk: Path) -> subprocess.CompletedProcess[str]:
    """Python, where packages are installed in a folder of their own."""
    environment = os.environ | {"PYTHONPATH": str(desk / "packages")}
    command = [sys.executable, *arguments.split()]
    return subprocess.run(command, cwd=desk, env=environment, capture_output=True, text=True, timeout=300)


def test_the_adapter_of_the_guide_passes_the_suite_for_what_it_can(packages: Path) -> None:
    done = run("-m pytest -rs -p no:cacheprovider toy-drive", packages.parent)
    assert done.returncode == 0, done.stdout
    passed = re.search(r"(\d+) passed, (\d+) skipped", done.stdout)
    assert passed is not None
    assert int(passed[1]) >= 30
    reasons = {line.rsplit(": ", 1)[1] for line in done.stdout.splitlines() if line.startswith("SKIPPED")}
    assert reasons == {
        "it has no sweep mode host_streamed", "it has sweep mode drive_side", "it takes several hosts at a time",
        "it has no load encoder", "it has no second axis",
    }  # fmt: skip


def test_an_adapter_that_forgets_a_gear_does_not_pass(packages: Path) -> None:
    adapter = packages.parent / "toy-drive" / "toy_adapter.py"
    text, right = adapter.read_text(), "velocity=rows[:, 2] / self._gear"
    assert right in text
    adapter.write_text(text.replace(right, "velocity=rows[:, 2]"))
    try:
        done = run("-m pytest -p no:cacheprovider toy-drive -k sweep_delivers", packages.parent)
    finally:
        adapter.write_text(text)
    assert done.returncode == 1, done.stdout
    assert "1 failed, 1 passed" in done.stdout
    assert re.search(r"assert .*1\.0\d+.* == 0\.0105 ±", done.stdout), done.stdout  # the suite's asserts tell values
