"""A command that reckons nothing loads nothing that reckons: a client answers at once, drives are soon there."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

MATHEMATICS = {"dask", "distributed", "plotly", "pyarrow", "scipy"}
SERVER = {"alembic", "fastapi", "sqlalchemy", "uvicorn"}
PHYSICS = {"mujoco"}
LOADED = """
import json, sys
from service.cli import build
try:
    build(sys.argv[1:])()
except SystemExit:
    json.dump(sorted({name.partition(".")[0] for name in sys.modules}), sys.stderr)
"""


def loaded(root: Path, code: str, *arguments: str) -> set[str]:
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
    code = "import service.stop_process.__main__, drivers.canopen, json, sys\n" + LOADED.splitlines()[-1].strip()
    assert loaded(root, code) & (MATHEMATICS | SERVER | PHYSICS | {"httpx", "pydantic_settings"}) == set()


def test_a_heavy_one_is_noticed(root: Path) -> None:
    assert {"scipy"} <= loaded(root, LOADED, "identify", "--help")
