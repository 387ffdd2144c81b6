"""A command that reckons nothing loads nothing that reckons: a client answers at once, drives are soon there."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

MATHEMATICS = {"dask", "distributed", "matplotlib", "plotly", "pyarrow", "scipy"}
SERVER = {"alembic", "fastapi", "sqlalchemy", "uvicorn"}
PHYSICS = {"mujoco"}
LOADED = """
import json, sys
from service.cli import build
try:
    build(sys.argv[1:])()
except SystemExit:
    json.dump(sorted(sys.modules), sys.stderr)
"""
TELL = LOADED.splitlines()[-1].strip()


def loaded(root: Path, code: str, *arguments: str) -> set[str]:
    return {name.partition(".")[0] for name in modules(root, code, *arguments)}


def modules(root: Path, code: str, *arguments: str) -> set[str]:
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=120, check=True)
    return set(json.loads(done.stderr))


@pytest.mark.parametrize(
    ("command", "heavy"),
    [
        ("--version", MATHEMATICS | SERVER | PHYSICS | {"numpy"}),
        ("drive", MATHEMATICS | SERVER | {"httpx"}),
        ("truth", MATHEMATICS | SERVER | {"can", "httpx"}),
        ("people", MATHEMATICS | PHYSICS | {"fastapi", "uvicorn"}),
        ("audit", MATHEMATICS | PHYSICS | {"fastapi", "uvicorn"}),
        ("measure", MATHEMATICS | SERVER | PHYSICS | {"numpy"}),
        ("report", MATHEMATICS | SERVER | PHYSICS),
        ("export", MATHEMATICS | SERVER | PHYSICS | {"numpy"}),
        ("plan-trajectories", MATHEMATICS | SERVER | PHYSICS),
        ("commission", MATHEMATICS | SERVER | PHYSICS),
    ],
)
def test_a_light_command_loads_nothing_heavy(root: Path, command: str, heavy: set[str]) -> None:
    words = [command] if command.startswith("-") else [command, "--help"]
    assert loaded(root, LOADED, *words) & heavy == set()


def test_the_stop_process_loads_nothing_heavy(root: Path) -> None:
    code = f"import service.stop_process.__main__, drivers.canopen, json, sys\n{TELL}"
    assert loaded(root, code) & (MATHEMATICS | SERVER | PHYSICS | {"httpx", "pydantic_settings"}) == set()


def test_the_service_loads_nothing_that_only_its_worker_needs(root: Path) -> None:
    """Every start of the service would pay for it, and a service that starts late is a machine that stands."""
    found = modules(root, LOADED, "serve", "--help")
    worker = {"service.data_check", "service.diagnosis.diagnose", "service.report.campaign", "simulator"}
    assert found & (worker | {"service.report.paper", "scipy.stats", "weasyprint", "dask", "s3fs"}) == set()


def test_a_virtual_can_machine_loads_no_modbus(root: Path) -> None:
    found = loaded(root, LOADED, "drive", "--help")
    assert "canopen" in found
    assert found & {"aiohttp", "pymodbus"} == set()


def test_a_worker_that_has_no_job_yet_loads_nothing_heavy(root: Path) -> None:
    """Nor does who only hands jobs over: the mathematics comes with the first job that reckons with it."""
    found = modules(root, f"import service.worker.process, json, sys\n{TELL}")
    assert {name.partition(".")[0] for name in found} & (MATHEMATICS | SERVER | PHYSICS) == set()
    assert found & {"service.data_check", "service.diagnosis", "service.identification", "service.report"} == set()


@pytest.mark.parametrize(
    "module",
    [
        "service.estimation",
        "service.planning.plan",
        "service.planning.trajectories.plan",
        "service.diagnosis.diagnose",
        "service.data_check",
    ],
)
def test_the_mathematics_needs_no_catalogue_of_distributions(root: Path, module: str) -> None:
    """Quantiles are functions of `scipy.special`; `scipy.stats` costs more than all else of SciPy."""
    found = modules(root, f"import {module}, json, sys\n{TELL}")
    assert "scipy.special" in found
    assert "scipy.stats" not in found


def test_a_heavy_one_is_noticed(root: Path) -> None:
    assert {"scipy"} <= loaded(root, LOADED, "identify", "--help")
