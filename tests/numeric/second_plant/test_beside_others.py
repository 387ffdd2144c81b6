"""Effects that are seen only beside others: dry friction whose reversals need the right distance, a small delay.

And a soft gear whose fit has other minima, and links that a parallelogram turns.
"""

import pytest

from service.diagnosis.diagnose import AxisResult, diagnose_axis
from service.diagnosis.fit import search
from service.diagnosis.verdict import Verdict
from tests.numeric.second_plant.cases import Case, Kind, make


def diagnosed(case: Case) -> AxisResult:
    robot, joint, sweeps, _ = make(case)
    return diagnose_axis(robot, joint, sweeps, twin=False)


@pytest.mark.parametrize(
    "case",
    [
        Case(8301, 50_000, Kind.PAIR, ("asymmetric_friction", "cogging_torque"), "medium"),
        Case(8301, 50_020, Kind.PAIR, ("coulomb_friction", "cogging_torque"), "medium"),
        Case(8301, 50_031, Kind.PAIR, ("effort_offset", "coulomb_friction"), "large"),
        # ripple of the mesh, which no spring carries
        Case(8301, 50_025, Kind.PAIR, ("joint_elasticity", "transmission_error"), "large"),
        Case(8301, 50_005, Kind.PAIR, ("hose_spring", "nonlinear_viscous_friction"), "large"),
        # asymmetric friction contains the offset
        Case(8301, 60_010, Kind.TRIPLE, ("measurement_delay", "asymmetric_friction", "effort_offset"), "medium"),
    ],
    ids=lambda case: str(case.number),
)
def test_each_is_named(case: Case) -> None:
    found = diagnosed(case)
    assert (found.verdict, {one.name for one in found.effects}) == (Verdict.NAMED, set(case.names[:2]))


def test_no_effect_is_exchanged_for_one_that_physics_forbids() -> None:
    """Friction that drives in one direction would explain all; the part that is known remains, and is told."""
    hidden = ("transmission_error", "asymmetric_friction", "effort_offset")
    found = diagnosed(Case(8301, 60_001, Kind.TRIPLE, hidden, "large"))
    told = {"transmission_error", "coulomb_friction", "effort_offset"}
    assert (found.verdict, {one.name for one in found.part}) == (Verdict.UNKNOWN, told)


@pytest.mark.parametrize("number", [30_808, 30_811])
def test_a_soft_gear_has_its_stiffness(number: int) -> None:
    """The fit has other minima, with a gear four times as soft that hardens as much as it may."""
    robot, joint, sweeps, truth = make(Case(8303, number, Kind.SINGLE, ("joint_elasticity",), "large"))
    (found,) = diagnose_axis(robot, joint, sweeps, twin=False).effects
    stiffness = 1 / found.parameters["compliance"].value
    assert stiffness == pytest.approx(truth.hidden["joint_elasticity"]["stiffness"], rel=0.03)


def test_from_the_load_of_the_fit_the_first_start_settles(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the load of CAD no step lowers the cost."""
    monkeypatch.setattr(search, "ELSEWHERE", ())
    robot, joint, sweeps, truth = make(Case(8303, 30_806, Kind.SINGLE, ("joint_elasticity",), "large"))
    (found,) = diagnose_axis(robot, joint, sweeps, twin=False).effects
    stiffness = 1 / found.parameters["compliance"].value
    assert stiffness == pytest.approx(truth.hidden["joint_elasticity"]["stiffness"], rel=0.03)


@pytest.mark.parametrize("number", [91_006, 91_009, 91_013])  # a SCARA, the driven axis of an arm, one on a track
def test_a_parallelogram_is_named_alone(number: int) -> None:
    """Gravity error and payload free more of the load, and explain no more."""
    robot, joint, sweeps, truth = make(Case(8303, number, Kind.SINGLE, ("parallelogram",), "large"))
    found = diagnose_axis(robot, joint, sweeps)
    assert (found.verdict, [one.name for one in found.effects]) == (Verdict.NAMED, ["parallelogram"])
    before = robot.joints[robot.index(truth.hidden["parallelogram"]["joint"]) - 1]
    share = found.effects[0].parameters[f"share_{before}"]
    assert share.value == pytest.approx(1.0, abs=0.01)
    assert joint in (before, truth.hidden["parallelogram"]["joint"])
