"""A small plan for the representative robot, and the virtual CNC it is exported for."""

import json
from pathlib import Path

import pytest

from service.machine.paths.sweep_paths import CncControl, read_control
from service.model import Robot
from service.model.configuration import Cell, read_cell, read_robot
from service.planning.documents import PlanDocument, PlanRequest
from service.planning.plan import build_plan

ROOT = Path(__file__).parents[4]
ROBOT, CELL = ROOT / "config/robots/max100-class.yaml", ROOT / "config/cells/workshop.yaml"
CONTROL = ROOT / "config/controls/sinumerik.yaml"


@pytest.fixture(scope="session")
def robot() -> Robot:
    return read_robot(ROBOT)


@pytest.fixture(scope="session")
def cell() -> Cell:
    return read_cell(CELL)


@pytest.fixture(scope="session")
def control(robot: Robot) -> CncControl:
    return read_control(CONTROL, robot)


@pytest.fixture(scope="session")
def plan(robot: Robot, cell: Cell) -> PlanDocument:
    request = PlanRequest(
        robot_id=1,
        cell="workshop",
        axes=("joint_1", "joint_2", "joint_3"),
        varied=("joint_2", "joint_3"),
        step=30,
        poses=3,
    )
    return build_plan(robot, request, cell)


@pytest.fixture
def plan_file(plan: PlanDocument, tmp_path: Path) -> Path:
    """As `sweepid plan --out` writes it."""
    path = tmp_path / "plan.json"
    record = {"id": 1, "robot_id": 1, "document": plan.model_dump(mode="json"), "created_at": "2026-01-01T00:00:00Z"}
    path.write_text(json.dumps(record))
    return path
