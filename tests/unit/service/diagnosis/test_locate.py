"""Where the gap is, in words: only in one direction, growing with something, largest somewhere, or nowhere."""

import numpy as np

from service.diagnosis.design import full_design
from service.diagnosis.diagnose import diagnose_axis
from service.diagnosis.equations import Term
from service.diagnosis.locate import Cell, sentences
from tests.numeric.campaign import max100
from tests.unit.service.diagnosis.following import following

POSES = np.array([[0.0, -1.0, 0.2, 0, 0, 0], [0.0, 0.3, 0.2, 0, 0, 0], [0.0, 1.2, 0.2, 0, 0, 0]])


def cell(dimension: str, value: str, rms: float) -> Cell:
    return Cell(dimension, value, rms, 100.0 * rms, 0.0)


def test_the_pattern_comes_first_and_what_it_says_is_not_said_twice() -> None:
    found = [cell("weight", "upwards", 1.0), cell("weight", "downwards", 20.0)]
    found += [cell("|gravity torque|", f"{k}e2 to {k + 1}e2 N m", 4.0 + 3 * k) for k in (2, 0, 1, 3)]
    found += [cell("block", "reversal", 30.0), *(cell("block", name, 5.0) for name in ("wide", "forward_slow"))]
    assert sentences("joint_2", found) == (
        "joint_2: only when moving downwards, grows with |gravity torque|.",
        "joint_2: the gap is largest at block reversal (30 against 17.8).",
    )


def test_a_gap_that_is_everywhere_alike_has_no_pattern() -> None:
    found = [cell("direction", "forward", 10.0), cell("direction", "backward", 9.0)]
    found += [cell("speed", f"{k} to {k + 1} rad/s", rms) for k, rms in enumerate((9.0, 11.0, 9.5, 10.0))]
    assert sentences("joint_1", found) == ("joint_1: the gap is about the same everywhere.",)


def test_what_is_said_of_real_sweeps_is_what_their_cells_show() -> None:
    robot = max100()
    designed = full_design(robot, "joint_2", POSES, blocks=("forward_slow", "backward_slow", "wide"))
    sweeps = following(robot, "joint_2", designed, {Term("joint_elasticity", (1e-6, 1e-3)): (1.0,)})
    found = diagnose_axis(robot, "joint_2", sweeps, twin=False)
    assert found.sentences[0] == "joint_2: grows with speed."
    speeds = {float(one.value.split()[0]): one.rms for one in found.cells if one.dimension == "speed"}
    assert speeds[max(speeds)] > 1.5 * speeds[min(speeds)]
    assert {one.value for one in found.cells if one.dimension == "weight"} == {"upwards", "downwards"}
