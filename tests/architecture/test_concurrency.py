"""Every thread and task of the product has a name, and `docs/explanation/concurrency.md` tells what it does.

No task loses its cancellation.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

PACKAGES = ("service", "drivers")
APART = {"contract", "demo"}  # what outsiders' tests run, and a command that ends with its processes
MAKERS = {"Thread": "name", "ThreadPoolExecutor": "thread_name_prefix", "create_task": "name"}


def names_in(source: str) -> Iterator[tuple[int, str | None]]:
    """Line and name of each thread, executor and task; the fixed beginning of a name that goes on, None without one."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        function = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if function in MAKERS:
            given = [keyword.value for keyword in node.keywords if keyword.arg == MAKERS[function]]
            if not (given and isinstance(given[0], ast.Name)):  # a parameter: the caller names it
                yield node.lineno, text_of(given[0]) if given else None
        elif function == "begin" and len(node.args) == 2 and text_of(node.args[0]) is not None:
            yield node.lineno, text_of(node.args[0])


def text_of(node: ast.expr) -> str | None:
    if isinstance(node, ast.JoinedStr):
        node = node.values[0]
    return node.value.strip() if isinstance(node, ast.Constant) and isinstance(node.value, str) else None


def sources(root: Path) -> Iterator[Path]:
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            if APART.isdisjoint(path.parts):
                yield path


def told(page: str) -> set[str]:
    return set(re.findall(r"`([^`]+)`", page))


def test_the_page_names_every_thread_and_task(root: Path) -> None:
    page = told((root / "docs" / "explanation" / "concurrency.md").read_text())
    missing = [
        f"{path.relative_to(root)}:{line}: {name or 'has no name'}"
        for path in sources(root)
        for line, name in names_in(path.read_text())
        if name not in page
    ]
    assert missing == []


def test_what_the_page_names_is_there(root: Path) -> None:
    found = {name for path in sources(root) for _, name in names_in(path.read_text())}
    page = (root / "docs" / "explanation" / "concurrency.md").read_text()
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    named = {name for row in rows for name in told(row)}
    assert len(named) > 20
    by_callers = {"can-sdo", "modbus", "identification"}
    assert named - found == by_callers
    texts = "".join(path.read_text() for path in sources(root))
    assert all(f'DriveThread("{name}")' in texts for name in ("can-sdo", "modbus"))


def test_no_cancellation_is_lost(root: Path) -> None:
    """`asyncio.wait_for` of Python 3.11 loses one that comes together with the result; `asyncio.timeout` does not."""
    assert [path for path in sources(root) if "asyncio.wait_for" in path.read_text()] == []
