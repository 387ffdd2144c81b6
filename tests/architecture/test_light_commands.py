"""A command that reckons nothing loads nothing that reckons: a client answers at once, drives are soon there."""

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

import pytest

from service.cli import build
from tests.unit.service.cli.test_identify import bundle

__all__ = ["bundle"]  # the fixture

pytestmark = pytest.mark.slow

MATHEMATICS = {"dask", "distributed", "matplotlib", "plotly", "pyarrow", "scipy"}
SERVER = {"alembic", "fastapi", "sqlalchemy", "uvicorn"}
PHYSICS = {"mujoco"}
NOTHING = MATHEMATICS | SERVER | PHYSICS
LATE = {"service.data_check", "service.diagnosis", "service.identification.estimates", "service.report"}
WORKER = {f"service.{name}" for name in ("data_check", "diagnosis.diagnose", "report.campaign", "report.plotting")}
HEAVY = NOTHING | {"can", "canopen", "httpx", "numpy", "rich", "structlog", "yaml"}
"""What no help text needs. Pydantic is not among them: Typer declares options with it."""
LOADED = """
import json, sys
from service.cli import build
try:
    build()(sys.argv[1:])
except BaseException:
    json.dump(sorted(sys.modules), sys.stderr)
"""
MEASURED = """
import json, os, subprocess, sys
costs = []
for words in json.load(sys.stdin):
    process = subprocess.Popen([sys.executable, *words], stdout=subprocess.DEVNULL)
    _, process.returncode, used = os.wait4(process.pid, 0)
    assert process.returncode == 0, words
    costs.append((used.ru_utime + used.ru_stime, used.ru_maxrss / 1024))
json.dump(costs, sys.stdout)
"""
HELP_TEXTS = """
import io, json, sys
from contextlib import redirect_stdout
from service.cli import build
names = [name for name, _ in build().every()]
with redirect_stdout(io.StringIO()):
    for name in ("", *names, *{name.partition(" ")[0] for name in names}):
        build()([*name.split(), "--help"], prog_name="sweepid", standalone_mode=False)
json.dump(sorted(sys.modules), sys.stderr)
"""
TEXTS = [("--help",), *((word, "--help") for word in build().commands)]
TELL = LOADED.splitlines()[-1].strip()
MEMORY = 60  # MB of a help text
TIMES = 14  # processor time of a help text over that of `python -c pass`: 0.3 s where that takes 0.021 s
TIMES_VERSION = 6


def loaded(root: Path, code: str, *arguments: str) -> set[str]:
    return {name.partition(".")[0] for name in modules(root, code, *arguments)}


def modules(root: Path, code: str, *arguments: str) -> set[str]:
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=120, check=True)
    return set(json.loads(done.stderr.splitlines()[-1]))


@dataclass(frozen=True)
class Cost:
    """Of a process: processor time, s, and largest memory, MB."""

    time: float
    memory: float


def costs(root: Path, runs: Sequence[Sequence[str]]) -> list[Cost]:
    """Of Python with such arguments. Run by a small process: a child counts the memory of its parent as its own."""
    done = subprocess.run(
        [sys.executable, "-c", MEASURED], cwd=root, input=json.dumps(runs), capture_output=True, text=True, check=True
    )
    return [Cost(*map(float, told)) for told in json.loads(done.stdout)]


def test_no_help_text_imports_what_computes(root: Path) -> None:
    """All of them in one process: what any of them imports is there at its end."""
    assert loaded(root, HELP_TEXTS) & HEAVY == set()


def test_a_help_text_is_there_at_once(root: Path) -> None:
    """Ratios in one run, because the load of the computer is in both; the mean, because a single one is too short."""
    script = str(Path(sys.executable).with_name("sweepid"))
    bare = fmean(one.time for one in costs(root, [("-c", "pass")] * 20))
    found = dict(zip(TEXTS, costs(root, [(script, *text) for text in TEXTS]), strict=True))
    assert {text: one.memory for text, one in found.items() if one.memory > MEMORY} == {}
    assert fmean(one.time for one in found.values()) < TIMES * bare
    assert fmean(one.time for one in costs(root, [(script, "--version")] * 10)) < TIMES_VERSION * bare


@pytest.mark.parametrize(
    ("command", "heavy"),
    [
        ("--version", HEAVY),
        ("drive --scenario none", MATHEMATICS | SERVER | {"httpx", "aiohttp", "pymodbus"}),  # of a CAN machine
        ("drive truth none --poses none", MATHEMATICS | SERVER | {"can", "httpx"}),
        ("people list --data-dir none", MATHEMATICS | PHYSICS | {"fastapi", "uvicorn"}),
        ("audit verify --data-dir none", MATHEMATICS | PHYSICS | {"fastapi", "uvicorn"}),
        ("measure none", NOTHING | {"numpy"}),
        ("report 1 none.html --url http://127.0.0.1:1", NOTHING),
        ("export 1 none --url http://127.0.0.1:1", NOTHING | {"numpy"}),
        ("plan trajectories none --axes a", NOTHING),
        ("commission check none", NOTHING),
        # every start of the service would pay for what its worker needs, and a late service is a machine that stands
        ("serve --config none", WORKER | {"simulator", "scipy.stats", "weasyprint", "dask", "s3fs"}),
    ],
)
def test_a_light_command_loads_nothing_heavy(root: Path, command: str, heavy: set[str]) -> None:
    """It is called with input that is not there: then all that it uses is imported."""
    found = modules(root, LOADED, *command.split())
    assert (found | {name.partition(".")[0] for name in found}) & heavy == set()


def test_identify_loads_only_what_it_uses(root: Path, bundle: Path) -> None:
    found = modules(root, LOADED, "identify", str(bundle), "--json", "-")
    assert "service.identification.estimation" in found
    heavy = SERVER | {"can", "dask", "distributed", "httpx", "plotly", "rich"}
    assert {name.partition(".")[0] for name in found} & heavy == set()
    assert not {name for name in found if name.startswith(("service.data_check", "service.report", "service.planning"))}


@pytest.mark.parametrize(
    ("imported", "heavy"),
    [
        ("sweepid", HEAVY | {"pydantic", "typer"}),  # in a notebook its functions import what they use when called
        ("service.machine.stop_process.__main__, drivers.canopen", NOTHING | {"httpx", "pydantic_settings"}),
        ("service.jobs.worker", NOTHING | LATE),  # of a worker that has no job yet, and of who only hands jobs over
        # quantiles are functions of scipy.special; scipy.stats costs more than all else of SciPy
        ("service.identification.estimation, service.planning.plan, service.planning.trajectories", {"scipy.stats"}),
        ("service.diagnosis.diagnose, service.data_check", {"scipy.stats"}),
    ],
)
def test_an_import_loads_nothing_heavy(root: Path, imported: str, heavy: set[str]) -> None:
    found = modules(root, f"import {imported}, json, sys\n{TELL}")
    assert (found | {name.partition(".")[0] for name in found}) & heavy == set()


def test_a_heavy_one_is_noticed(root: Path) -> None:
    assert {"scipy"} <= loaded(root, LOADED, "import", "trace", "none", "--out", "none")
