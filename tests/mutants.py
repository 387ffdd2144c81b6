"""How much the unit tests of a room notice: small errors are put into its code, one at a time; which survive?

python -m tests.mutants --each 15 --seed 1 --list FILE      so many of each room, and what became of them
python -m tests.mutants --again FILE                        the same ones, after the tests have changed

Nothing in the checkout is written: an error is put in when its module is imported, in a process of its own.
"""

import argparse
import ast
import json
import os
import random
import resource
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache, partial
from importlib import import_module
from importlib.machinery import SourceFileLoader
from itertools import groupby
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
ROOMS = {  # its unit tests, folders or files below tests/unit; the first row that a file is in
    "service/machine/execution": "service/campaigns",
    "service/machine/paths": "service/paths",
    "service/machine/stop_process": "service/test_stop_process.py service/campaigns",
    "service/machine": "service/campaigns service/test_tasks.py",
    "service/planning/safety": "service/campaigns service/test_collision.py",
    "service/planning": "service/campaigns",
    "drivers/cia402": "drivers",
    "drivers/canopen": "drivers",
    "drivers/commission": "drivers",
    "drivers/modbus": "drivers",
    "simulator": "simulator",
    "service/identification/model": "service/identification",
    "service/identification/axis": "service/identification",
    "service/identification": "service/identification service/fleet",
    "service/data_check": "service/data_check",
    "service/diagnosis": "service/diagnosis",
    "service/store": "service/store service/backup service/objects service/people",
    "service/jobs": "service/store service/test_worker.py service/campaigns",
    "service/formats/traces": "service/test_trace_*.py",
    "service/formats/maker_urdf": "service/maker_urdf service/test_urdf.py",
    "service/formats": "service/export service/sinumerik service/test_trace_*.py",
    "service/model": "service/results service/test_robot.py service/test_settings.py service/test_channels.py",
    "service/web": "service/api service/people service/hmi",
    "service/report": "service/report service/benefit",
    "service/publishing": "service/publishing",
    "service/cli": "service/cli",
}
SAFETY_AND_CORE = ["service/machine/execution", "service/planning/safety", "service/planning"]
SAFETY_AND_CORE += ["drivers/cia402", "drivers/canopen", "service/identification/model", "service/identification/axis"]
CPU = 120  # s for the tests of one mutant: one that goes round for ever is noticed
HEAVY = ("canopen", "pydantic", "scipy.linalg", "scipy.optimize", "sqlalchemy")  # imported once
NOTHING_FAILED, GONE = (0, 5), 99  # pytest's codes: all passed, none left by the mark; ours: the code has changed
PAIRS = "Lt LtE, Gt GtE, Eq NotEq, Is IsNot, In NotIn, And Or, Add Sub, Mult Div"
SWAPS = {getattr(ast, a): getattr(ast, b) for pair in PAIRS.split(", ") for a, b in (pair.split(), pair.split()[::-1])}
NAMED = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def wrong(node: ast.AST) -> ast.AST | None:
    """The node with an error in it, if there is one for it."""
    match node:
        case ast.Compare(ops=[op], comparators=[_]) if type(op) in SWAPS:
            return ast.Compare(node.left, [SWAPS[type(op)]()], node.comparators)
        case ast.BoolOp(op=op):
            return ast.BoolOp(SWAPS[type(op)](), node.values)
        case ast.BinOp(op=op) if type(op) in SWAPS:
            return ast.BinOp(node.left, SWAPS[type(op)](), node.right)
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            return node.operand
        case ast.Constant(value=bool() | int() | float() as value):
            return ast.Constant(not value if isinstance(value, bool) else value + 1)
        case ast.Expr(value=ast.Call() | ast.Await()) | ast.Raise() | ast.AugAssign():
            return ast.Pass()
        case _:
            return None


def mutants(file: str, tree: ast.AST) -> Iterator[tuple[dict[str, Any], Callable[[], None]]]:
    """Each with what puts it into the tree."""
    seen = Counter[tuple[str, str]]()

    def walk(node: ast.AST, function: str) -> Iterator[tuple[dict[str, Any], Callable[[], None]]]:
        for field, value in ast.iter_fields(node):
            if field in ("annotation", "returns", "decorator_list") or isinstance(node, ast.JoinedStr):
                continue
            for place, child in enumerate(value if isinstance(value, list) else [value]):
                if not isinstance(child, ast.AST):
                    continue
                if function and (error := wrong(child)) is not None:
                    code = ast.unparse(child)
                    seen[function, code] += 1
                    key = {"file": file, "function": function, "code": code, "nth": seen[function, code]}
                    put = [*value[:place], error, *value[place + 1 :]] if isinstance(value, list) else error
                    shown = {"line": getattr(child, "lineno", 0), "error": ast.unparse(error)}
                    yield key | shown, partial(setattr, node, field, put)
                yield from walk(child, f"{function}.{child.name}" if isinstance(child, NAMED) else function)

    return walk(tree, "")


def plant(mutant: dict[str, Any]) -> None:
    """From now on in this process."""
    path, as_it_is = str(ROOT / mutant["file"]), SourceFileLoader.get_code

    def get_code(self: SourceFileLoader, fullname: str) -> Any:
        if self.path != path:
            return as_it_is(self, fullname)
        tree = ast.parse(Path(path).read_text("utf-8"))
        for key, put in mutants(mutant["file"], tree):
            if all(key[name] == mutant[name] for name in ("function", "code", "nth")):
                put()
                return compile(ast.fix_missing_locations(tree), path, "exec")
        os._exit(GONE)

    SourceFileLoader.get_code = get_code


def tested(files: list[str], mutant: dict[str, Any] | None) -> int:
    """The exit code of the tests in a process of their own."""
    if (child := os.fork()) == 0:
        import pytest

        resource.setrlimit(resource.RLIMIT_CPU, (CPU, CPU))
        for output in (1, 2):
            os.dup2(os.open(os.devnull, os.O_WRONLY), output)
        if mutant is not None:
            plant(mutant)
        os._exit(int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-m", "not slow", *files])))
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@cache
def sound(files: tuple[str, ...]) -> bool:
    """Whether the tests pass where no error is put in."""
    return tested(list(files), None) in NOTHING_FAILED


def room_of(file: str) -> str:
    return next(room for room in ROOMS if file.startswith(f"{room}/"))


def outcome(mutant: dict[str, Any]) -> str:
    """First the tests that name the module, then the others of the room; one that fails as well without is no proof."""
    module = mutant["file"].removesuffix(".py").replace("/", ".")
    found = [path for name in ROOMS[room_of(mutant["file"])].split() for path in (ROOT / "tests/unit").glob(name)]
    files = sorted({str(file) for path in found for file in (path.rglob("test_*.py") if path.is_dir() else [path])})
    near = [file for file in files if module in Path(file).read_text("utf-8")]
    for some in filter(None, (near, [file for file in files if file not in near])):
        if (code := tested(some, mutant)) not in NOTHING_FAILED:
            return "gone" if code == GONE else "killed" if sound(tuple(some)) else "unclear"
    return "survived"


def chosen(room: str, each: int, seed: int) -> list[dict[str, Any]]:
    files = [str(path.relative_to(ROOT)) for path in sorted((ROOT / room).rglob("*.py"))]
    found = [key for file in files for key, _ in mutants(file, ast.parse((ROOT / file).read_text("utf-8")))]
    return random.Random(f"{room} {seed}").sample(found, min(each, len(found)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--room", nargs="+", choices=list(ROOMS), default=SAFETY_AND_CORE)
    parser.add_argument("--each", type=int, default=15, help="mutants of each room")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--list", type=Path, default=Path(os.devnull), help="where to keep them")
    parser.add_argument("--again", type=Path, help="the list to try again")
    options = parser.parse_args()
    for name in HEAVY:
        import_module(name)
    turns = zip(*(chosen(room, options.each, options.seed) for room in options.room), strict=False)
    todo = json.loads(options.again.read_text("utf-8")) if options.again else [each for turn in turns for each in turn]
    for each in todo:
        each["before"], each["outcome"] = each.get("outcome", ""), outcome(each)
        print(f"{each['outcome']}: {each['file']}:{each['line']}: {each['code']} -> {each['error']}", flush=True)
        options.list.write_text(json.dumps(todo, indent=1) + "\n", "utf-8")
    for room, each in groupby(sorted(todo, key=lambda one: room_of(one["file"])), lambda one: room_of(one["file"])):
        print(room, dict(Counter(one["outcome"] for one in each)))
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"processor time {used.ru_utime + used.ru_stime:.0f} s")


if __name__ == "__main__":
    main()
