"""Effects that are seen only beside others: dry friction whose reversals need the right distance, a small delay."""

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


@pytest.mark.parametrize(
    ("number", "kind", "hidden"),
    [
        (50_005, Kind.PAIR, ("hose_spring", "nonlinear_viscous_friction")),
        (60_010, Kind.TRIPLE, ("measurement_delay", "asymmetric_friction", "effort_offset")),
    ],
)
def test_an_effect_is_confirmed_beside_the_others(number: int, kind: Kind, hidden: tuple[str, ...]) -> None:
    robot, joint, sweeps, _ = make(Case(8301, number, kind, hidden, "large" if kind is Kind.PAIR else "medium"))
    found = axis_document(diagnose_axis(robot, joint, sweeps))
    assert (found.verdict, {effect.effect for effect in found.effects}) == ("named", set(hidden[:2]))
