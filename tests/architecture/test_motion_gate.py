"""One file of the service gives energy and moves, `service/machine/execution/motion.py`; one other holds its port.

Each way to it needs an `Intention`, which is made only where a request arrives. So the list of entries is complete by
construction: the gate wants the value, nobody else can make one, none is left out by default, and the type checker
finds who passes none. Who keeps one keeps it with its epoch.
"""

import ast
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

GATE, HOLDER = "machine/execution/motion.py", "machine/execution/machine.py"
MOTION = "service.machine.execution.motion"
ARRIVAL = "web/api/dependencies.py"  # makes the intentions
GUARDED = {
    HOLDER: {"check_may_move", "used_by", "motion"},
    "machine/execution/sweep_executor.py": {"run"},
    "machine/execution/runner.py": {"start", "resume", "check_free"},
    "jobs/experiments.py": {"approve", "permit"},
}
ENTRIES = {  # routes of the API that lead to motion; a new one is added here on purpose
    "start_campaign",
    "resume_campaign",
    "approve_plan",  # the first of two steps; it moves nothing
    "approve_experiment",
    "add_diagnosis",  # unattended, on a virtual machine
}
MOVES = {"enable", "disable", "move_to", "run_sweep", "run_noise"}  # of `drivers.ports.DrivePort`


def violations(path: str, source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute) and node.attr in MOVES and path != GATE:
            yield f"{path}:{node.lineno}: .{node.attr}"
        if isinstance(node, ast.Attribute) and node.attr in ("port", "_port") and _of_machine(node) and path != HOLDER:
            yield f"{path}:{node.lineno}: the port of the machine"
        if isinstance(node, ast.alias) and node.name == "DrivePort" and path not in (GATE, HOLDER):
            yield f"{path}: imports DrivePort"
        taken = isinstance(node, ast.alias) and node.name == "MotionAccess" and f"{MOTION} import" in source
        if taken and path not in (HOLDER, "machine/execution/sweep_executor.py"):
            yield f"{path}: imports MotionAccess"


def made_elsewhere(path: str, source: str) -> Iterator[str]:
    """Intentions that are not made at the arrival of a request, or that a function does without."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        place = f"{path}:{getattr(node, 'lineno', 0)}"
        if isinstance(node, ast.Call):
            called, given = _last(node.func), ast.unparse(node)
            if called == "Intention" and path != ARRIVAL:
                yield f"{place}: makes an intention"
            if called in ("replace", "cast", "setattr", "__setattr__", "copy") and "intention" in given.lower():
                yield f"{place}: makes an intention of another"
        if isinstance(node, ast.alias) and node.name == "Intention" and node.asname:
            yield f"{place}: another name for it"
        if isinstance(node, ast.ClassDef) and "Intention" in map(_last, node.bases):
            yield f"{place}: a kind of it"
        if isinstance(node, ast.Attribute) and node.attr == "Intention":
            yield f"{place}: it is named by its module"
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            for argument, default in _arguments(node):
                wanted = "" if argument.annotation is None else ast.unparse(argument.annotation)
                if "Intention" in wanted and (default is not None or wanted.strip("'\"") not in _REQUIRED):
                    yield f"{place}: {node.name} does without an intention"


_REQUIRED = ("Intention", "IntentionOf")


def _last(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def _arguments(function: ast.FunctionDef | ast.AsyncFunctionDef) -> Iterator[tuple[ast.arg, ast.expr | None]]:
    of = function.args
    positional = [*of.posonlyargs, *of.args]
    yield from zip(positional, [None] * (len(positional) - len(of.defaults)) + of.defaults, strict=True)
    yield from zip(of.kwonlyargs, of.kw_defaults, strict=True)


def wanting(source: str, annotation: str) -> set[str]:
    """Functions with a parameter of this annotation."""
    return {
        node.name
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and any(each.annotation and ast.unparse(each.annotation) == annotation for each, _ in _arguments(node))
    }


def _of_machine(node: ast.Attribute) -> bool:
    owner = node.value
    name = owner.attr if isinstance(owner, ast.Attribute) else getattr(owner, "id", "")
    return name.endswith("machine") or name == "motion"


def sources(root: Path) -> dict[str, str]:
    service = root / "service"
    return {path.relative_to(service).as_posix(): path.read_text() for path in sorted(service.rglob("*.py"))}


@pytest.mark.slow
def test_nothing_else_moves(root: Path) -> None:
    assert [line for path, source in sources(root).items() for line in violations(path, source)] == []


def test_an_intention_is_made_only_where_a_request_arrives(root: Path) -> None:
    code = {path: source for path, source in sources(root).items() if "Intention" in source}
    assert [line for path, source in code.items() for line in made_elsewhere(path, source)] == []
    assert code[ARRIVAL].count("Intention(") == 1
    for path, names in GUARDED.items():
        assert names - wanting(code[path], "Intention") == set()
    entries = [wanting(source, "IntentionOf") for path, source in code.items() if path.startswith("web/api/")]
    assert set().union(*entries) == ENTRIES


@pytest.mark.parametrize(
    "source",
    [
        "machine.port.stop()",
        "self._machine._port.enable('joint_1')",
        "port.move_to('joint_1', 0.0, 1.0)",
        "from drivers.ports import DrivePort",
        "from service.machine.execution.motion import MotionAccess",
        "anything.run_sweep(command)",
        "runner.start(1, Intention(epochs.now))",
        "runner.start(1, epoch.Intention(epochs.now))",
        "replace(old.intention, epoch=epochs.now)",
        "runner.start(1, cast('Intention', None))",
        "async def start(self, intention: Intention | None) -> None: ...",
        "async def start(self, intention: Intention = NOBODYS) -> None: ...",
        "async def start(self, *, intention: 'Intention' = NOBODYS) -> None: ...",
        "from service.machine.execution.energising import Intention as Wanted",
        "class Always(Intention): ...",
    ],
)
def test_a_planted_violation_is_found(source: str) -> None:
    path = "jobs/experiments.py"
    assert [*violations(path, source), *made_elsewhere(path, source)]


PLANTED = """
from fastapi import APIRouter

from service.web.api.dependencies import ApplicationOf, IntentionOf
from service.jobs.experiments import Experiments
from service.machine.execution.energising import Epochs
from service.machine.execution.machine import Machine
from service.machine.execution.motion import Bounds
from service.machine.execution.runner import Runner

router = APIRouter()


@router.post("/allowed")
async def allowed(application: ApplicationOf, intention: IntentionOf) -> None:
    await application.runner.start(1, intention)


@router.post("/start")
async def start(application: ApplicationOf) -> None:
    await application.runner.start(1)  # planted


async def others(runner: Runner, experiments: Experiments, epochs: Epochs, machine: Machine, bounds: Bounds) -> None:
    await runner.resume(1)  # planted
    await experiments.approve(1, "joint_1", "nobody", None, None)  # planted
    await runner.start(1, epochs.now)  # planted
    await runner.start(1, None)  # planted
    with machine.used_by("a handler"):  # planted
        async with machine.motion(bounds):  # planted
            machine.check_may_move()  # planted
"""


@pytest.mark.slow
def test_the_type_checker_finds_each_entry_without_an_epoch(root: Path, tmp_path: Path) -> None:
    planted = tmp_path / "planted.py"
    planted.write_text(PLANTED)
    settings = {"include": ["."], "extraPaths": [str(root)], "typeCheckingMode": "strict", "pythonVersion": "3.11"}
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings | {"reportMissingTypeStubs": "none"}))
    command = [str(Path(sys.executable).with_name("basedpyright")), "-p", str(tmp_path), "--outputjson"]
    ran = subprocess.run(
        [*command, "--pythonpath", sys.executable], capture_output=True, text=True, check=False, timeout=300
    )
    found = {one["range"]["start"]["line"] for one in json.loads(ran.stdout)["generalDiagnostics"]}
    assert found == {number for number, line in enumerate(PLANTED.splitlines()) if "# planted" in line}
