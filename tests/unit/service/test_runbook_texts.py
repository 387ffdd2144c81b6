"""What the runbooks say of a motion and of a fault, without a machine."""

import importlib
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.unit.service.benefit.pair import URDF, robot

RUNBOOKS = Path(__file__).parents[3] / "docs" / "how-to" / "runbooks"


@pytest.fixture
def runbook(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A module of the runbooks by its name."""
    monkeypatch.setattr(sys, "path", [str(RUNBOOKS), *sys.path])
    return importlib.import_module


def test_the_last_axis_moves_what_is_mounted_on_it(runbook: Any) -> None:
    turned = URDF.replace('name="j2" type="prismatic"', 'name="j2" type="revolute"')
    turned = turned.replace('<axis xyz="1 0 0"/>', '<axis xyz="0 0 1"/>')
    arm = robot()
    arm = type(arm)(arm.description, turned)
    sweep = {
        "spec": {"axis": "j2", "pose": [0.0, 0.5]},
        "duration": 10.0,
        "position_window": [0.4, 0.6],
        "legs": [],
    }
    (move,) = runbook("moves").moves(arm, [sweep], {"j2": 0.5})
    assert move.joint == "j2"
    assert move.arm_mm == pytest.approx(1e3 * 0.5 * 0.2)  # the flange is 0.5 m from the axis


def test_an_axis_through_the_end_of_the_arm_tells_no_motion_of_it(runbook: Any) -> None:
    turned = URDF.replace('name="j2" type="prismatic"', 'name="j2" type="revolute"').replace("0.5 0 0.7", "0.5 0 0")
    arm = type(robot())(robot().description, turned)
    sweep = {"spec": {"axis": "j2", "pose": [0.0, 0.5]}, "duration": 1.0, "position_window": [0.4, 0.6], "legs": []}
    (move,) = runbook("moves").moves(arm, [sweep], {})
    assert move.arm_mm is None
    assert "the arm's end" not in runbook("runbook").told(move)


def test_an_emergency_stop_is_told_by_its_name(runbook: Any) -> None:
    fault_of = runbook("after_a_stop").fault_of
    fault = {"text": "error 9000h", "code": 0x9000, "emergency_stop": True}
    assert fault_of({"fault": fault}) == "EMERGENCY STOP, error 9000h (9000h)"
    assert fault_of({"fault": fault | {"emergency_stop": False}}) == "error 9000h (9000h)"
    assert not fault_of({"fault": None})
