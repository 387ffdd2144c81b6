"""How much the unit tests of a room notice: small errors are put into its code, one at a time; which survive?

python -m tests.mutants --each 15 --seed 1 --list FILE      so many of each room, and the list of them with what became
python -m tests.mutants --again FILE                        the same ones, after the tests have changed

Nothing in the checkout is written: a mutant is compiled when its module is imported, in a process of its own.
"""

import argparse
import ast
import importlib.abc
import importlib.util
import json
import os
import random
import resource
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
CAMPAIGNS, DRIVERS, IDENTIFICATION = (
    f"tests/unit/{name}" for name in ("service/campaigns", "drivers", "service/identification")
)
ROOMS = {
    "service/execution": CAMPAIGNS,
    "service/safety": CAMPAIGNS,
    "service/planning": CAMPAIGNS,
    "drivers/cia402": DRIVERS,
    "drivers/canopen": DRIVERS,
    "service/identification/model": IDENTIFICATION,
    "service/identification/axis": IDENTIFICATION,
}
CPU, WALL = 120, 600  # s for the tests of one mutant: one that goes round for ever is noticed
HEAVY = ("canopen", "pydantic", "scipy.linalg", "scipy.optimize", "sqlalchemy")  # imported once
NAMED = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
SWAPS: dict[type, type] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
}  # fmt: skip


def changed(node: ast.AST) -> ast.AST | None:
    """The node with an error in it, if there is one for it."""
    match node:
        case ast.Compare(ops=[op], comparators=[_]) if type(op) in SWAPS:
            return ast.Compare(node.left, [SWAPS[type(op)]()], node.comparators)
        case ast.BoolOp(op=op):
            return ast.BoolOp(SWAPS[type(op)](), node.values)
        case ast.BinOp(op=op) if type(op) in SWAPS and not isinstance(node.left, ast.Constant | ast.JoinedStr):
            return ast.BinOp(node.left, SWAPS[type(op)](), node.right)
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            return node.operand
        case ast.Constant(value=bool(value)):
            return ast.Constant(not value)
        case ast.Constant(value=int() | float() as value):
            return ast.Constant(value + 1 if isinstance(value, int) else value * 1.5 + (value == 0))
        case ast.Expr(value=ast.Call() | ast.Await()) | ast.Raise() | ast.AugAssign():
            return ast.Pass()
        case _:
            return None


def mutants(path: Path, tree: ast.AST) -> Iterator[tuple[dict[str, Any], ast.AST, str, int | None, ast.AST]]:
    """Each with its key, and where in the tree its node goes: what holds it, by which field, at which place."""
    seen = Counter[tuple[str, str]]()

    def walk(node: ast.AST, function: str) -> Iterator[tuple[dict[str, Any], ast.AST, str, int | None, ast.AST]]:
        for field, value in ast.iter_fields(node):
            if field in ("annotation", "returns", "decorator_list", "type_params") or isinstance(node, ast.JoinedStr):
                continue
            for place, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
                if not isinstance(child, ast.AST):
                    continue
                inside = f"{function}.{child.name}" if isinstance(child, NAMED) else function
                if function and (error := changed(child)) is not None:
                    text = ast.unparse(child)
                    seen[function, text] += 1
                    key = {"file": str(path), "function": function, "code": text, "nth": seen[function, text]}
                    shown = {"line": getattr(child, "lineno", 0), "error": ast.unparse(error)}
                    yield key | shown, node, field, place, ast.copy_location(error, child)
                yield from walk(child, inside)

    return walk(tree, "")


class Planted(importlib.abc.MetaPathFinder, importlib.abc.SourceLoader):
    """Imports one module with the error in it."""

    def __init__(self, mutant: dict[str, Any]) -> None:
        self._path = ROOT / mutant["file"]
        name = mutant["file"].removesuffix(".py").replace("/", ".").removesuffix(".__init__")
        self._name, self._mutant = name, mutant

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        return (
            importlib.util.spec_from_file_location(fullname, self._path, loader=self)
            if fullname == self._name
            else None
        )

    def get_filename(self, fullname: str) -> str:
        return str(self._path)

    def get_data(self, path: str) -> bytes:
        return Path(path).read_bytes()

    def source_to_code(self, data: Any, path: Any) -> Any:
        tree = ast.parse(data)
        for key, holder, field, place, error in mutants(Path(self._mutant["file"]), tree):
            if all(key[name] == self._mutant[name] for name in ("function", "code", "nth")):
                if place is None:
                    setattr(holder, field, error)
                else:
                    getattr(holder, field)[place] = error
                return compile(ast.fix_missing_locations(tree), path, "exec")
        os._exit(GONE)


PASSED, GONE = 0, 99


def tested(files: list[str], mutant: dict[str, Any] | None) -> int:
    """The exit code of the tests in a process of their own: 0 if they noticed nothing."""
    if (child := os.fork()) == 0:
        import pytest

        resource.setrlimit(resource.RLIMIT_CPU, (CPU, CPU))
        signal.alarm(WALL)
        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
        if mutant is not None:
            sys.meta_path.insert(0, Planted(mutant))
        os._exit(int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-m", "not slow", *files])))
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def outcome(mutant: dict[str, Any]) -> str:
    """First the tests that name the module, then the others of the room."""
    module = mutant["file"].removesuffix(".py").replace("/", ".")
    folder = next(tests for room, tests in ROOMS.items() if mutant["file"].startswith(f"{room}/"))
    near: list[str] = []
    far: list[str] = []
    for path in sorted((ROOT / folder).glob("test_*.py")):
        (near if module in path.read_text("utf-8") else far).append(str(path))
    for files in filter(None, (near, far)):
        code = tested(files, mutant)
        if code == GONE:
            return "gone"
        if code not in (PASSED, 5):  # 5: no test is left by the mark
            return "killed"
    return "survived"


def chosen(room: str, each: int, seed: int) -> list[dict[str, Any]]:
    paths = [path.relative_to(ROOT) for path in sorted((ROOT / room).rglob("*.py"))]
    keys = [key for path in paths for key, *_ in mutants(path, ast.parse((ROOT / path).read_text("utf-8")))]
    return random.Random(f"{room} {seed}").sample(keys, min(each, len(keys)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--room", nargs="+", choices=list(ROOMS), default=list(ROOMS))
    parser.add_argument("--each", type=int, default=15, help="mutants of each room")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--list", type=Path, help="where to keep them")
    parser.add_argument("--again", type=Path, help="the list to try again")
    options = parser.parse_args()
    for name in HEAVY:
        importlib.import_module(name)
    if options.again:
        todo = json.loads(options.again.read_text("utf-8"))
    else:
        turns = [chosen(room, options.each, options.seed) for room in options.room]
        todo = [room[k] for k in range(options.each) for room in turns if k < len(room)]
    for folder in sorted({ROOMS[room] for room in options.room}):
        if tested([folder], None) != PASSED:
            sys.exit(f"{folder}: the tests fail without an error planted: python -m pytest -m 'not slow' {folder}")
    for done, mutant in enumerate(todo, 1):
        mutant["before"], mutant["outcome"] = mutant.get("outcome", ""), outcome(mutant)
        place = f"{mutant['file']}:{mutant['line']}"
        print(f"{done}/{len(todo)} {mutant['outcome']}: {place}: {mutant['code']} -> {mutant['error']}", flush=True)
        if options.list:
            options.list.write_text(json.dumps(todo, indent=1) + "\n", "utf-8")
    for room in ROOMS:
        of = Counter(each["outcome"] for each in todo if each["file"].startswith(f"{room}/"))
        print(f"{room}: {of['killed']} killed, {of['survived']} survived, {of['gone']} gone")
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"processor time {used.ru_utime + used.ru_stime:.0f} s")


if __name__ == "__main__":
    main()
