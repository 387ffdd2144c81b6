"""Every parser of files from outside reads what no program wrote (`make fuzz`: more cases of it).

Allowed is that it is read or that the parser's documented error says why not. Anything else (another exception, death,
20 s of CPU, 1 GiB) is a finding: Hypothesis prints the seed that repeats it and tries it first next time; its files are
then in `var/fuzz`. (Chance is one number to Hypothesis. Drawing each choice by it found half as many kinds of refusal.)
"""

import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, cast

import pyarrow
import pytest
from hypothesis import Phase, given, settings, strategies as st

from service import BadInput
from tests.forked import copied
from tests.fuzz.edits import edited
from tests.fuzz.parsers import PARSERS
from tests.fuzz.seeds import ROOT, Seed, write_into

CASES = int(os.environ.get("FUZZ_CASES", "4"))  # of each parser
SECONDS, MEMORY = 20, 2**30  # of CPU; bytes of address space above what the process has when it begins
DONE = {"done": True}

pytestmark = pytest.mark.filterwarnings("ignore")  # of what numbers without sense overflow


@cache
def seeds_of(name: str) -> list[Seed]:
    return list(PARSERS[name].seeds())


def told_of(name: str, files: Mapping[str, bytes], entry: str, allowed: tuple[type[Exception], ...]) -> object:
    """What a copy of this process tells that reads the entry of these files."""
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        case, work = Path(folder) / "case", Path(folder) / "work"
        write_into(case, files)
        work.mkdir()

        def read() -> None:
            cast(Any, pyarrow).set_memory_pool(
                cast(Any, pyarrow).system_memory_pool()
            )  # others reserve what is limited
            try:
                PARSERS[name].read(case / entry, work)
            except allowed:
                pass
            except BadInput as error:  # where another error is the documented one
                raise RuntimeError("BadInput") from error

        return copied(read, SECONDS, MEMORY)


@pytest.mark.parametrize("name", list(PARSERS))
def test_a_parser_reads_its_seeds(name: str) -> None:
    for seed in seeds_of(name):
        assert told_of(name, seed.files, seed.entry, ()) == DONE


@pytest.mark.parametrize("name", list(PARSERS))
@settings(max_examples=CASES, print_blob=True, phases=(Phase.reuse, Phase.generate))  # no seed is smaller than another
@given(rng=st.randoms(use_true_random=True))
def test_a_parser_reads_or_refuses(name: str, rng: Random) -> None:
    seed = rng.choice(seeds_of(name))
    target = rng.choice(seed.targets)
    files = seed.files | {target: edited(target, seed.files[target], rng)}
    told = told_of(name, files, seed.entry, PARSERS[name].allowed)
    if told != DONE:
        write_into(ROOT / "var/fuzz" / name.replace(" ", "-"), files)
    assert told == DONE


def endless() -> None:
    while True:
        pass


@pytest.mark.skipif(sys.platform != "linux", reason="limits of address space")
@pytest.mark.parametrize(
    ("task", "told"),
    [
        (lambda: {}["planted"], "KeyError"),
        (os.abort, "SIGABRT"),
        (lambda: bytearray(2**31), "memory"),
        (endless, "SIGKILL"),
    ],
    ids=["raises", "dies", "grows", "hangs"],
)
def test_what_breaks_is_found(task: Callable[[], object], told: str) -> None:
    assert told in str(copied(task, 1, MEMORY))
