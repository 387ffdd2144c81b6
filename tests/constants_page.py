"""Numeric constants of the mathematics: those in the code, and those with a source on `docs/reference/constants.md`."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/reference/constants.md"
FOLDERS = ("identification", "diagnosis", "data_check", "planning")
APART = {"fleet", "estimation.py", "campaigns"}  # what keeps and counts, not what computes

PLAIN = frozenset({0.0, 0.5, 1.0, 2.0, 1e3})  # halves, wholes, milli: no one sets them
GUARD = 1e-30  # and below: it guards a division by zero

Row = tuple[str, str]  # name, value


def in_code() -> dict[str, str]:
    """Value of every constant by `folder name`, as source text.

    A constant is an assignment of a module to names in capitals with a number in it, `file.NAME`; tuples stay together.
    So is a field of a class whose fields all have a value, `file.Class.field`.
    Other numbers with a decimal point or an exponent are listed by function, `file.function()`, in their order. Fields
    of requests have their defaults and limits in the HTTP reference.
    """
    found: dict[str, str] = {}
    for folder in FOLDERS:
        room = ROOT / "service" / folder
        for path in sorted(path for path in room.rglob("*.py") if path.relative_to(room).parts[0] not in APART):
            place = f"{path.parent.relative_to(ROOT).as_posix()} {path.stem}"
            for name, value in _of_module(ast.parse(path.read_text("utf-8"))):
                key = f"{place}.{name}"
                assert key not in found, f"{key} twice in {path}"
                found[key] = value
    return found


def on_page(text: str) -> dict[str, list[str]]:
    """Cells of each row after the name, by `file.NAME`."""
    found: dict[str, list[str]] = {}
    for line in text.partition("\n## ")[0].splitlines():
        if line.startswith("| `"):
            name, *cells = [cell.strip() for cell in line.replace(r"\|", "¦").strip("| ").split(" | ")]
            assert name.strip("`") not in found, f"{name} has two rows"
            found[name.strip("`")] = cells
    return found


def same(one: str, other: str) -> bool:
    """Whether two source texts are the same expression."""
    return ast.dump(ast.parse(one)) == ast.dump(ast.parse(other))


def _of_module(tree: ast.Module) -> Iterator[Row]:
    numbers: dict[str, list[str]] = {}
    for statement in tree.body:
        target, value = _assignment(statement)
        if target is not None and value is not None and _is_constant(target, value):
            names = [ast.unparse(one) for one in (target.elts if isinstance(target, ast.Tuple) else [target])]
            yield ", ".join(names), _written(value)
        elif target is not None and value is not None:
            numbers.setdefault(f"{ast.unparse(target)}()", []).extend(_numbers(value))
        elif isinstance(statement, ast.ClassDef) and (fields := _settings(statement)):
            yield from ((f"{statement.name}.{name}", _written(value)) for name, value in fields)
        else:
            for name, number in _in_definitions(statement, ""):
                numbers.setdefault(f"{name}()", []).append(number)
    for name, found in numbers.items():
        if found:
            yield name, ", ".join(dict.fromkeys(found))


def _settings(statement: ast.ClassDef) -> list[tuple[str, ast.expr]]:
    """Fields with a number of a dataclass in which every field has a value."""
    fields = [one for one in statement.body if isinstance(one, ast.AnnAssign)]
    if statement.bases or not statement.decorator_list or not all(one.value for one in fields):
        return []
    valued = [(ast.unparse(one.target), one.value) for one in fields if one.value]
    return [(name, value) for name, value in valued if any(_is_number(part) for part in ast.walk(value))]


def _assignment(statement: ast.stmt) -> tuple[ast.expr | None, ast.expr | None]:
    if isinstance(statement, ast.Assign):
        return statement.targets[0], statement.value
    return (statement.target, statement.value) if isinstance(statement, ast.AnnAssign) else (None, None)


def _is_constant(target: ast.expr, value: ast.expr) -> bool:
    """In capitals, with a number, and no object of a class nor part of another constant."""
    names = target.elts if isinstance(target, ast.Tuple) else [target]
    if not all(isinstance(one, ast.Name) and one.id == one.id.upper() and one.id[0] != "_" for one in names):
        return False
    parts = list(ast.walk(value))
    made = any(isinstance(p, ast.Call) and isinstance(p.func, ast.Name) and p.func.id[0].isupper() for p in parts)
    cut = any(isinstance(part, ast.Slice) for part in parts)
    return not made and not cut and any(_is_number(part) for part in parts)


def _is_number(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def _written(value: ast.expr) -> str:
    """Source text of a value, a tuple of plain numbers without brackets."""
    return (
        ast.unparse(value).removeprefix("(").removesuffix(")") if isinstance(value, ast.Tuple) else ast.unparse(value)
    )


def _numbers(node: ast.AST) -> list[str]:
    """Numbers with a decimal point or an exponent that someone has set."""
    return [
        repr(part.value)
        for part in ast.walk(node)
        if isinstance(part, ast.Constant)
        and isinstance(part.value, float)
        and part.value not in PLAIN
        and part.value > GUARD
    ]


def _in_definitions(node: ast.AST, name: str) -> Iterator[Row]:
    """Numbers by the innermost function or class that is not nested in a function."""
    if isinstance(node, ast.ClassDef):
        if any(ast.unparse(base) == "BaseModel" for base in node.bases):
            return
        for child in node.body:
            yield from _in_definitions(child, node.name)
    elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        yield from ((node.name, number) for number in _numbers(node))
    elif name:
        yield from ((name, number) for number in _numbers(node))
