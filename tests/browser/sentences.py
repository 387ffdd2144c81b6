"""The sentences that the service can tell a person, from its source, with 7 for each value."""

import ast
from collections.abc import Iterator
from pathlib import Path

from drivers.errors import CausedError, DriveError
from service import SweepidError
from service.web.api.problem import RequestRefused

TELLS = {"Cause", "DataFinding", "Trouble", "Unfinished"}
UNTOLD = {"BadProfile"}  # the service does not start with it


def errors(kind: type[Exception]) -> Iterator[str]:
    yield kind.__name__
    for one in kind.__subclasses__():
        yield from errors(one)


def told(node: ast.AST) -> Iterator[str]:
    """Each whole sentence below a node."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.JoinedStr):
        yield "".join(str(one.value) if isinstance(one, ast.Constant) else "7" for one in node.values)
    else:
        for child in ast.iter_child_nodes(node):
            yield from told(child)


def sentences(root: Path, *places: str) -> set[str]:
    """What errors, causes and findings of these folders and files say."""
    kinds = {name for kind in (DriveError, SweepidError, CausedError, RequestRefused) for name in errors(kind)}
    found: set[str] = set()
    for path in (
        path for place in places for path in ([root / place] if place.endswith(".py") else (root / place).rglob("*.py"))
    ):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Name)
                and node.func.id in kinds - UNTOLD | TELLS
            ):
                values = [*node.args, *(one.value for one in node.keywords if one.arg not in ("code", "by", "unit"))]
                found |= {text for value in values for text in told(value) if " " in text.strip()}
    return found
