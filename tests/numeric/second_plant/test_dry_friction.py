"""Dry friction beside ripples of the motor, whose reversals need the right distance to be seen as dry."""

import pytest

from service.diagnosis.diagnose import diagnose_axis
from service.diagnosis.document import axis_document
from tests.numeric.second_plant.cases import Case, Kind, make


@pytest.mark.parametrize(("number", "friction"), [(50_000, "asymmetric_friction"), (50_020, "coulomb_friction")])
def test_dry_friction_is_named_beside_cogging(number: int, friction: str) -> None:
    hidden = (friction, "cogging_torque")
    robot, joint, sweeps, _ = make(Case(8301, number, Kind.PAIR, hidden, "medium"))
    found = axis_document(diagnose_axis(robot, joint, sweeps))
    assert (found.verdict, {effect.effect for effect in found.effects}) == ("named", set(hidden))
