"""How large the house is: ``python -m tests.architecture.size``. Figures to look at, no test."""

import ast
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
PRODUCT = ("service", "drivers", "simulator", "sweepid")
APART = (
    "formats",
    "publishing",
    "machine/paths",
    "identification/fleet",
    "store/back_up.py",
    "store/examination.py",
    "store/objects.py",
    "store/plant.py",
    "store/retention.py",
)
"""Folders of the service outside of the core: formats, plant, publishing."""
WIRE_AND_STORE = (
    "service/store",  # rows, files
    "service/model/results",  # the documents that are stored and sent
    "service/jobs/work.py",  # what goes to a worker and comes back
    "service/web/api",
    "service/web/client.py",
    "service/publishing",
    "service/machine/stop_process",  # a pipe
    "simulator/control.py",  # JSON lines over TCP
)


def files(*folders: str) -> Iterator[Path]:
    for folder in folders:
        yield from sorted((ROOT / folder).rglob("*.py"))


def lines(found: Iterator[Path]) -> int:
    return sum(path.read_text("utf-8").count("\n") for path in found)


def is_core(path: Path) -> bool:
    return not _is_within(path, ("simulator", *(f"service/{folder}" for folder in APART)))


def _is_within(path: Path, places: Iterable[str]) -> bool:
    return any(path.relative_to(ROOT).is_relative_to(place) for place in places)


def figures() -> Iterator[tuple[str, int | str]]:
    """Name and value."""
    product = list(files(*PRODUCT))
    trees = {path: ast.parse(path.read_text("utf-8")) for path in product}
    total = lines(iter(product))
    yield "lines of the product", total
    yield "of these in the core", lines(path for path in product if is_core(path))
    for folder in (*PRODUCT, "tests", "docs"):
        yield f"lines in {folder}", lines(files(folder))
    yield (
        "rooms of the service",
        len([path for path in (ROOT / "service").iterdir() if (path / "__init__.py").is_file()]),
    )
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
    yield "layers of the service", len(next(one["layers"] for one in contracts if one["id"] == "floors"))
    nodes = [node for tree in trees.values() for node in ast.walk(tree)]
    imports = sum(isinstance(node, ast.Import | ast.ImportFrom) for node in nodes)
    yield "import statements per 1,000 lines", round(1000 * imports / total)
    classes = Counter(node.name for node in nodes if isinstance(node, ast.ClassDef))
    yield "class names defined twice or more", sum(count > 1 for count in classes.values())
    yield "the most frequent", ", ".join(f"{name} {count}" for name, count in classes.most_common(8))
    yield "constants of modules", sum(len(constants(tree)) for tree in trees.values())
    loose = {path: len(re.findall(r"dict\[str, Any\]|\bJsonValue\b", path.read_text("utf-8"))) for path in product}
    yield "dict[str, Any] and JsonValue", sum(loose.values())
    outside = {path: count for path, count in loose.items() if not _is_within(path, WIRE_AND_STORE)}
    yield "of these outside of wire and store", sum(outside.values())
    yield "words of the documents", sum(len(path.read_text("utf-8").split()) for path in ROOT.glob("docs/**/*.md"))


def _is_type_variable(value: ast.expr | None) -> bool:
    return isinstance(value, ast.Call) and ast.unparse(value.func) in ("TypeVar", "ParamSpec")


def constants(tree: ast.Module) -> list[str]:
    """Names in capitals that a module assigns."""
    targets = [
        target
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign) and not _is_type_variable(node.value)
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
    ]
    named = [name for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
    return [name.id for name in named if re.fullmatch(r"_?[A-Z][A-Z0-9_]*", name.id)]


if __name__ == "__main__":
    for name, value in figures():
        print(f"{value:>12,}  {name}" if isinstance(value, int) else f"{name}: {value}")
