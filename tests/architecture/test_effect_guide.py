"""Whoever follows the guide to an effect has it named by `sweepid diagnose`; what is broken is told in one line."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.guide import written

pytestmark = pytest.mark.slow

BIN = Path(sys.executable).parent


def run(line: str, desk: Path, packages: Path) -> subprocess.CompletedProcess[str]:
    """A line of the guide, where packages are installed in a folder of their own."""
    environment = os.environ | {"PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(packages)}
    return subprocess.run(line.split(), cwd=desk, env=environment, capture_output=True, text=True, timeout=300)


@pytest.mark.slow
def test_the_effect_of_the_guide_is_named(tmp_path: Path, root: Path) -> None:
    install, *others = written("write-an-effect.md", tmp_path / "seal-drag")
    (tmp_path / "config").symlink_to(root / "config")
    packages = tmp_path / "packages"
    offline = install.replace("pip install", f"python -m pip install --no-index --target {packages}")
    for line in (offline, *others[:-1], f"{others[-1]} --json -"):
        done = run(line, tmp_path, packages)
        assert done.returncode == 0, done.stderr
    axis = json.loads(done.stdout)["axes"]["joint_1"]
    assert axis["verdict"] == "named"
    (effect,) = axis["effects"]
    assert effect["effect"] == "seal_drag"
    found = {name: value["value"] for name, value in effect["parameters"].items()}
    assert found == pytest.approx({"mean": 60.0, "cosine": 20.0, "sine": -30.0}, abs=2.0)
    assert axis["gap"]["after_rms"] < 1.5 * axis["gap"]["noise_floor_rms"]


@pytest.mark.slow
def test_a_broken_effect_is_one_line_and_two(tmp_path: Path, root: Path) -> None:
    (tmp_path / "broken-1.0.dist-info").mkdir()
    (tmp_path / "broken-1.0.dist-info/METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (tmp_path / "broken-1.0.dist-info/entry_points.txt").write_text("[sweepid.effects]\nmagic = no_such:EFFECT\n")
    done = run(f"sweepid serve --port 0 --data-dir {tmp_path / 'data'}", root, tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = (line for line in done.stderr.splitlines() if line.startswith("sweepid: "))
    assert line == (
        "sweepid: package broken 1.0, entry point sweepid.effects: magic = no_such:EFFECT: "
        "cannot be loaded: ModuleNotFoundError: No module named 'no_such'"
    )
