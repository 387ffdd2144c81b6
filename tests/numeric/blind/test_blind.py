"""A few of the blind cases; `python -m tests.numeric.blind.score` runs them all."""

from pathlib import Path

import pytest

from tests.numeric.blind.cases import Case, Design, Kind
from tests.numeric.blind.score import run, scores

CASES = (
    (Kind.NONE, (), "none"),
    (Kind.SINGLE, ("measurement_delay",), "medium"),
    (Kind.PAIR, ("coulomb_friction", "cogging_torque"), "large"),
    (Kind.OUTSIDE, ("friction_step",), "large"),
)


@pytest.mark.parametrize(("kind", "names", "size"), CASES, ids=lambda part: str(part))
def test_a_hidden_effect_is_found(kind: Kind, names: tuple[str, ...], size: str, tmp_path: Path) -> None:
    for name in ("truth", "diagnoses"):
        (tmp_path / name).mkdir()
    run(Case(1, kind, names, size, Design.FULL, (2, 1)), tmp_path)
    (score,) = scores(tmp_path)
    assert score.expected, (score.truth, score.diagnosis)
