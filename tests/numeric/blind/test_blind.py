"""A few of the blind cases; `python -m tests.numeric.blind.score` runs them all."""

from pathlib import Path

import pytest

from tests.numeric.blind.cases import Case, Design, Kind
from tests.numeric.blind.score import run, scores

CASES = (
    Case(1, Kind.NONE, (), "none", Design.FULL, (2, 1)),
    Case(1, Kind.SINGLE, ("measurement_delay",), "medium", Design.FULL, (2, 1)),
    Case(3, Kind.SINGLE, ("coulomb_friction",), "medium", Design.FULL, (105, 3)),  # bristles that push would fit better
    Case(1, Kind.PAIR, ("coulomb_friction", "cogging_torque"), "large", Design.FULL, (2, 1)),
    Case(1, Kind.OUTSIDE, ("friction_step",), "large", Design.FULL, (2, 1)),
)


@pytest.mark.parametrize("case", CASES, ids=lambda case: " and ".join(case.names) or "none")
def test_a_hidden_effect_is_found(case: Case, tmp_path: Path) -> None:
    for name in ("truth", "diagnoses"):
        (tmp_path / name).mkdir()
    run(case, tmp_path)
    (score,) = scores(tmp_path)
    assert score.expected, (score.truth, score.diagnosis)
