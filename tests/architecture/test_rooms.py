"""No two folders of the service need each other (record 0019)."""

import ast
from collections import defaultdict
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

HISTORY = "migrations"  # one file a step, in order of time

Arrows = dict[str, set[str]]


def sources(*rooms: Path) -> list[Path]:
    return [path for room in rooms for path in room.rglob("*.py") if HISTORY not in path.parts]


def module(path: Path, root: Path) -> str:
    return ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")


def imported(path: Path, modules: set[str]) -> set[str]:
    """The modules of the service that a file imports."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found & modules


def arrows_between_folders(root: Path) -> dict[str, Arrows]:
    """For each folder: which of its sub-folders import which."""
    paths = {module(path, root): path for path in sources(root / "service")}
    packages = {name for name, path in paths.items() if path.name == "__init__.py"}
    arrows: dict[str, Arrows] = defaultdict(lambda: defaultdict(set))
    for name, path in paths.items():
        for other in imported(path, set(paths)) - packages:
            if name in packages:
                continue
            ours, theirs = name.split(".")[:-1], other.split(".")[:-1]
            common = next((k for k, (a, b) in enumerate(zip(ours, theirs, strict=False)) if a != b), None)
            if common is not None:
                arrows[".".join(ours[:common])][ours[common]].add(theirs[common])
    return arrows


@pytest.mark.slow
def test_no_two_folders_need_each_other(root: Path) -> None:
    arrows = arrows_between_folders(root)
    assert {"service", "service.identification", "service.diagnosis"} <= arrows.keys()
    for within in arrows.values():
        TopologicalSorter(within).prepare()  # CycleError names the folders


def test_a_circle_would_be_found(tmp_path: Path) -> None:
    for folder, line in (("a", "from service.b.n import N"), ("b", "from service.a import m")):
        (tmp_path / "service" / folder).mkdir(parents=True)
        (tmp_path / "service" / folder / "__init__.py").touch()
        (tmp_path / "service" / folder / ("m.py" if folder == "a" else "n.py")).write_text(line)
    with pytest.raises(ValueError, match="cycle"):
        TopologicalSorter(arrows_between_folders(tmp_path)["service"]).prepare()
