"""The loop of a diagnosis never ends without a word: on a few machines, and on a hundred in the second tier."""

import pytest

from tests.numeric.second_plant.cases import Case, Kind
from tests.numeric.second_plant.loop import Course, course, hundred

SEED, PARTS = 11, 12


def check(one: Course) -> None:
    """It ended in a verdict or said why there is none; all that it proposed could be run, and was proposed once."""
    assert (one.broken, bool(one.end)) == ([], True), one


@pytest.mark.parametrize(
    "one",
    [
        Case(SEED, 1003, Kind.NONE, (), "none"),
        Case(SEED, 30600, Kind.SINGLE, ("gravity_error",), "large"),
        Case(SEED, 10000, Kind.SINGLE, ("coulomb_friction",), "small"),
    ],
    ids=lambda one: f"{one.number}-{'-'.join(one.names) or 'none'}",
)
def test_a_diagnosis_ends(one: Case) -> None:
    check(course(one))


@pytest.mark.parametrize("part", range(PARTS))
def test_a_hundred_diagnoses_end(part: int) -> None:
    for one in hundred(SEED)[part::PARTS]:
        check(course(one))
