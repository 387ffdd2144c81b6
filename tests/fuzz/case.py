"""One case: what is made of a parser's seeds by a seed of chance and a number, and what came of reading it."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from random import Random

from tests.fuzz.mutation import mutated
from tests.fuzz.parsers import PARSERS, write_into
from tests.fuzz.planted import PLANTED
from tests.fuzz.seeds import Seed

KNOWN = {**PARSERS, **PLANTED}


@dataclass(frozen=True)
class Case:
    """`files` is all that the parser gets, `entry` what it is told to read."""

    parser: str
    seed: int
    number: int
    entry: str
    files: Mapping[str, bytes]


def make(parser: str, chosen: list[Seed], seed: int, number: int) -> Case:
    """The same case for the same numbers and seeds."""
    rng = Random(f"{parser}/{seed}/{number}")
    start = rng.choice(chosen)
    target = rng.choice(start.targets)
    files = dict(start.files) | {target: mutated(target, start.files[target], rng)}
    return Case(parser, seed, number, start.entry, files)


def read(case: Case, folder: Path) -> str:
    """Let the parser read it: "read", or the documented error that it raised. Whatever else it raises goes on."""
    parser, work = KNOWN[case.parser], folder / "work"
    write_into(folder / "case", case.files)
    write_into(work, {})
    work.mkdir()
    try:
        parser.read(folder / "case" / case.entry, work)
    except parser.allowed as error:
        return type(error).__name__
    return "read"


def keep(case: Case, what: str, folder: Path) -> Path:
    """Write a finding: its file is for ``python -m tests.fuzz --case``, the folder beside it holds what was read."""
    name = f"{case.parser.replace(' ', '-').replace(chr(39), '')}-{case.seed}-{case.number}"
    write_into(folder / name, case.files)
    told = asdict(case) | {"files": sorted(case.files), "what": what}
    path = folder / f"{name}.json"
    path.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    return path


def kept(path: Path) -> Case:
    """The case of a finding's file."""
    told = json.loads(path.read_text(encoding="utf-8"))
    files = {name: (path.with_suffix("") / name).read_bytes() for name in told["files"]}
    return Case(told["parser"], told["seed"], told["number"], told["entry"], files)
