"""The contracts of the import arrows in pyproject.toml, which `make check` holds against the code, really bite."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PLANTED = (  # file, and what it must not import
    ("simulator/__init__.py", "drivers.errors"),
    ("drivers/errors.py", "service"),
    ("service/store/__init__.py", "simulator"),
    ("service/diagnosis/model/held_out_check.py", "simulator"),
    ("service/planning/campaigns/__init__.py", "drivers.registry"),
    ("service/identification/estimation.py", "sweepid"),
    ("sweepid/files.py", "service.cli.terminal"),
    ("service/__init__.py", "service.store"),
    ("service/identification/model/regressor.py", "time"),
    ("service/data_check/check.py", "time"),
    ("service/data_check/check.py", "service.diagnosis"),
    ("service/model/urdf.py", "pathlib"),
    ("service/planning/campaigns/state_machine.py", "scipy"),
    ("drivers/registry.py", "drivers.contract"),
    ("service/web/hmi/__init__.py", "service.store"),
)
CIRCLE = ("service/identification/axis/axis_estimate.py", "service.identification.estimates.estimate")


@pytest.mark.slow
def test_planted_violations_are_found(root: Path, tmp_path: Path) -> None:
    for room in ("sweepid", "service", "drivers", "simulator"):
        shutil.copytree(root / room, tmp_path / room, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(root / "pyproject.toml", tmp_path)
    for file, module in (*PLANTED, CIRCLE):
        with (tmp_path / file).open("a", encoding="utf-8") as planted:
            planted.write(f"\nimport {module}\n")
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "COLUMNS": "200"}
    checked = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
    assert checked.returncode == 1, checked.stderr
    assert " 0 kept, 9 broken" in checked.stdout
    for file, module in PLANTED:
        importer = file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        assert f"{importer} -> {module}" in checked.stdout
    assert "No cycles are allowed in service.identification" in checked.stdout
