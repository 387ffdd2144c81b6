"""A few cases of every parser, and the watch over children by readers that break. The rest: `make fuzz`."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.fuzz.case import Case, make, read
from tests.fuzz.parsers import PARSERS
from tests.fuzz.planted import PLANTED
from tests.fuzz.seeds import ROOT

CASES = 4


@pytest.mark.parametrize("name", list(PARSERS))
@pytest.mark.filterwarnings("ignore")  # of what numbers without sense overflow
def test_a_parser_reads_its_seeds_and_survives_some_cases(name: str, tmp_path: Path) -> None:
    chosen = list(PARSERS[name].seeds())
    assert {read(Case(name, 0, 0, seed.entry, seed.files), tmp_path) for seed in chosen} == {"read"}
    for number in range(CASES):
        read(make(name, chosen, 0, number), tmp_path)


def test_a_case_is_the_same_each_time() -> None:
    for name in ("robot", "estimate", "urdf", "csv"):
        chosen = list(PARSERS[name].seeds())
        assert make(name, chosen, 5, 3) == make(name, list(PARSERS[name].seeds()), 5, 3)
        assert make(name, chosen, 5, 3) != make(name, chosen, 5, 4)


def _fuzz(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tests.fuzz", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of address space")
def test_what_breaks_is_found_and_repeated(tmp_path: Path) -> None:
    named = [word for name in PLANTED for word in ("--parser", name)]
    first = _fuzz("--seed", "1", "--cpu", "0.03", "--least", "30", "--findings", str(tmp_path), *named)
    files = [str(next(tmp_path.glob(f"{name}-1-*.json"))) for name in PLANTED]
    again = _fuzz("--case", *files)
    assert (first.returncode, again.returncode) == (1, 1)
    raised = list(tmp_path.glob("raises-1-*.json"))
    assert len(raised) > 1  # more than one case of a kind, each with the files that were read
    assert all((path.with_suffix("") / "a.txt").is_file() for path in raised)
    for told in (first.stdout, again.stdout):
        assert all(what in told for what in ("KeyError", "SIGABRT", "MemoryError"))
