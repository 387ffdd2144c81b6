"""One file of the service gives energy and moves, `service/execution/motion.py`; one other holds the port for it."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

GATE, HOLDER = "execution/motion.py", "execution/machine.py"
MOVES = {"enable", "disable", "move_to", "run_sweep", "run_noise"}  # of `drivers.ports.DrivePort`


def violations(path: str, source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute) and node.attr in MOVES and path != GATE:
            yield f"{path}:{node.lineno}: .{node.attr}"
        if isinstance(node, ast.Attribute) and node.attr in ("port", "_port") and _of_machine(node) and path != HOLDER:
            yield f"{path}:{node.lineno}: the port of the machine"
        if isinstance(node, ast.alias) and node.name == "DrivePort" and path not in (GATE, HOLDER):
            yield f"{path}: imports DrivePort"
        taken = isinstance(node, ast.alias) and node.name == "Motion" and "service.execution.motion import" in source
        if taken and path not in (HOLDER, "execution/sweep_executor.py"):
            yield f"{path}: imports Motion"


def _of_machine(node: ast.Attribute) -> bool:
    owner = node.value
    name = owner.attr if isinstance(owner, ast.Attribute) else getattr(owner, "id", "")
    return name.endswith("machine") or name == "motion"


@pytest.mark.slow
def test_nothing_else_moves(root: Path) -> None:
    service = root / "service"
    found = [
        line
        for path in sorted(service.rglob("*.py"))
        for line in violations(path.relative_to(service).as_posix(), path.read_text())
    ]
    assert found == []


@pytest.mark.parametrize(
    "source",
    [
        "await machine.port.stop()",
        "await self._machine._port.enable('joint_1')",
        "await port.move_to('joint_1', 0.0, 1.0)",
        "from drivers.ports import DrivePort",
        "from service.execution.motion import Motion",
        "async for block in anything.run_sweep(command): pass",
    ],
)
def test_a_planted_violation_is_found(source: str) -> None:
    body = source if source.startswith("from") else f"async def f():\n    {source}"
    assert list(violations("execution/runner.py", body))
