"""The import arrows between and inside the rooms hold, and the contracts that say so really bite."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOMS = ("service", "drivers", "simulator")


def lint_imports(folder: Path) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    environment = os.environ | {"PYTHONPATH": str(folder), "COLUMNS": "200"}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)


def test_all_arrows_hold(root: Path) -> None:
    checked = lint_imports(root)
    assert checked.returncode == 0, checked.stdout


@pytest.mark.parametrize(
    ("module", "line", "contract", "arrow"),
    [
        ("simulator/__init__.py", "import drivers.errors", "rooms", "simulator -> drivers.errors"),
        ("drivers/errors.py", "import service.errors", "rooms", "drivers.errors -> service.errors"),
        ("service/store/__init__.py", "import simulator", "rooms", "service.store -> simulator"),
        (
            "service/diagnosis/model/held_out.py",
            "import simulator",
            "rooms",
            "service.diagnosis.model.held_out -> simulator",
        ),
        ("service/campaigns/__init__.py", "import drivers.registry", "rooms", "service.campaigns -> drivers.registry"),
        ("service/errors.py", "import service.store", "floors", "service.errors -> service.store"),
        (
            "service/identification/model/regressor.py",
            "import time",
            "mathematics",
            "service.identification.model.regressor -> time",
        ),
        ("service/data_check/check.py", "import time", "mathematics", "service.data_check.check -> time"),
        (
            "service/data_check/check.py",
            "import service.diagnosis",
            "floors",
            "service.data_check.check -> service.diagnosis",
        ),
        ("service/urdf.py", "import pathlib", "mathematics", "service.urdf -> pathlib"),
        ("service/campaigns/state_machine.py", "import scipy", "motion", "service.campaigns.state_machine -> scipy"),
        ("drivers/registry.py", "import drivers.contract", "contract", "drivers.registry -> drivers.contract"),
        ("service/hmi/__init__.py", "import service.store", "page", "service.hmi -> service.store"),
    ],
)
def test_a_planted_violation_is_found(
    root: Path, tmp_path: Path, module: str, line: str, contract: str, arrow: str
) -> None:
    for room in ROOMS:
        shutil.copytree(root / room, tmp_path / room, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(root / "pyproject.toml", tmp_path)
    planted = tmp_path / module
    planted.write_text(f"{planted.read_text()}\n{line}\n")
    checked = lint_imports(tmp_path)
    assert checked.returncode == 1, checked.stderr
    assert "BROKEN" in checked.stdout
    assert arrow in checked.stdout, f"contract {contract} did not name the planted import"
