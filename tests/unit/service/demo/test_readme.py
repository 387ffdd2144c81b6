"""The figures of README: in the demo's words, and those that no noise touches as the demo computes them."""

import re
from pathlib import Path

import numpy as np
import pytest

from service.cli.demo import ERRORS, SCENARIO, error, read_truth
from service.cli.virtual_cell import CELL, ROBOT
from service.identification.model import axis_rows
from service.model.configuration import read_cell, read_robot
from service.planning.documents import PlanRequest
from service.planning.poses import workspace_grid


def test_the_errors_in_readme_are_those_that_the_demo_prints(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(root)
    head, _, *rows = (
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in (root / "README.md").read_text("utf-8").splitlines()
        if re.match(r"\| (error in %|formula of|sweepid (estimate|model)|CAD model)|\|---\|---\|---\|---", line)
    )
    assert tuple(row[0] for row in rows) == ERRORS
    robot, cell = read_robot(ROBOT), read_cell(CELL)
    joints = head[1:]
    request = PlanRequest(robot_id=1, cell=cell.name, axes=tuple(joints), varied=("joint_2", "joint_3"), poses=24)
    workspace = workspace_grid(robot, request, cell)
    motors = [axis.reflected_motor_inertia or 0.0 for axis in robot.axes]
    nominal = np.concatenate([robot.chain.inertial.ravel(), motors])
    true = read_truth(SCENARIO, workspace, tmp_path / "poses.json")
    cad = [error(axis_rows(robot.chain, robot.index(joint), workspace) @ nominal, true[joint]) for joint in joints]
    assert rows[ERRORS.index("CAD model, whole workspace")][1:] == cad
