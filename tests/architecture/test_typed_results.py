"""Results have types: `Any` and raw JSON objects stay at the edges."""

import ast
from collections import Counter
from pathlib import Path

import pytest

EDGES = {
    "api": "the wire: what comes as JSON and goes as JSON",
    "client": "the wire, from the other side",
    "data_check": "makes its document; held by the digest of the second plant's score",
    "diagnosis": "makes its documents; held by the same digest",
    "export/recordings": "files, by libraries without types",
    "logs": "fields of lines of the log, which may hold anything",
    "people/provider": "the wire to an identity provider: keys and claims as it sends them",
    "publishing/opcua": "nodes, by a library whose types do not hold",
    "results": "reads JSON into models",
    "stop_process": "a pipe",
    "store": "rows and files",
    "traces": "reads mappings of other people's columns",
    "worker": "a pipe",
}
"""Rooms (or files) of the service where JSON has no type yet or no more, and why."""


def raw(tree: ast.AST) -> int:
    """Uses of `Any`, and of JSON objects without a type, in code and in the words of a `cast`."""
    found = 0
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id == "Any":
            found += 1
        elif isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name):
            inner = ast.unparse(node.slice)
            found += node.value.id in ("dict", "Mapping") and inner in ("(str, JsonValue)", "(str, object)")
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "cast":
            words = node.args[0]
            if isinstance(words, ast.Constant) and isinstance(words.value, str):
                found += raw(ast.parse(words.value))
    return found


def counted(service: Path) -> dict[str, int]:
    """By folder, without the edges; folders without any are left out."""
    count: Counter[str] = Counter()
    for path in service.rglob("*.py"):
        place = path.relative_to(service)
        if not any(place.is_relative_to(edge) for edge in EDGES):
            count[place.parent.as_posix()] += raw(ast.parse(path.read_text("utf-8")))
    return {folder: number for folder, number in sorted(count.items()) if number}


@pytest.mark.slow
def test_results_have_types(root: Path) -> None:
    assert counted(root / "service") == {}


def test_every_edge_is_there(root: Path) -> None:
    assert [name for name in EDGES if not (root / "service" / name).exists()] == []


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("def told(document: dict[str, Any]) -> str: ...", 1),
        ("def told() -> Mapping[str, JsonValue]: ...", 1),
        ("x = cast('dict[str, object]', y)", 1),
        ("Json = dict[str, Any]", 1),
        ("from typing import Any", 0),
        ("def told(document: Diagnosis) -> dict[str, float]: ...", 0),
        ("def told(document: Diagnosis) -> str:\n    'Any dict[str, Any]'", 0),
    ],
)
def test_a_planted_violation_is_found(tmp_path: Path, line: str, found: int) -> None:
    for name in ("safety", "store"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "planted.py").write_text(line)
    assert counted(tmp_path) == ({"safety": found} if found else {})
