"""The second tier keeps what is promised in the first, names tests that are there, and its parts are of one size."""

import ast
import re
from pathlib import Path

import pytest

from tests.tiers import LONG, PARTS, SHORT, Name, name_of, named_by, part_of, parts


def functions_of(path: Path) -> set[str]:
    nodes = ast.walk(ast.parse(path.read_text("utf-8")))
    return {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)}


def test_what_is_promised_is_of_the_first_tier(root: Path) -> None:
    page = (root / "docs/explanation/safety.md").read_text("utf-8")
    promised = re.findall(r"\| `(tests/\S+\.py)::(\w+)` \|$", page, re.MULTILINE)
    assert len(promised) > 20
    later = [entry for entry in LONG for file, function in promised if named_by(entry, Name(file, function, "["))]
    assert later == []


@pytest.mark.slow
def test_each_line_names_a_test_that_is_there(root: Path) -> None:
    suite = {"tests/contract/test_drive_port.py", "tests/contract/test_faults.py"}  # classes of drivers.contract
    for entry in (*LONG, *SHORT):
        name = name_of(entry)
        files = [root / name.file, *((root / "drivers/contract").glob("*.py") if name.file in suite else ())]
        assert files[0].is_file(), entry
        assert name.function in {""}.union(*map(functions_of, files)), entry


def test_the_parts_are_of_one_size() -> None:
    costs = [sum(cost for entry, cost in LONG.items() if parts()[entry] == part) for part in range(1, PARTS + 1)]
    assert max(costs) < 1.1 * min(costs)


def test_a_line_names_a_file_a_function_or_some_of_its_cases() -> None:
    file = "tests/system/test_attack.py"
    assert part_of(f"{file}::test_a[b-c]") == parts()[file]
    death = "tests/contract/test_death.py::test_a_machine_that_dies_is_lost_communication"
    assert part_of(f"{death}[canopen-socketcand-drive_side]") is None
    assert part_of(f"{death}[modbus-rtu-drive_side]") == parts()[f"{death}[modbus-rtu"]
    port = "tests/contract/test_drive_port.py"
    assert part_of(f"{port}::TestDrivePort::test_identity_is_reported[modbus-rtu]") == parts()[f"{port}[modbus-rtu"]
    assert part_of(f"{port}::TestDrivePort::test_identity_is_checked[modbus-rtu]") is None
