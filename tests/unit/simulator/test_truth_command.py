"""`sweepid drive truth`: JSON on stdout, one line on stderr and exit code 2 for bad input."""

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from simulator import load_scenario, true_inertia
from simulator.truth_command import truth

FULL = Path(__file__).parents[3] / "config" / "scenarios" / "max100-full.yaml"


@pytest.fixture
def command() -> typer.Typer:
    app = typer.Typer()
    app.command()(truth)
    return app


def test_prints_the_inertia_of_every_moving_joint(command: typer.Typer, tmp_path: Path) -> None:
    poses = [[0.0] * 6, [0.0, 1.0, -0.5, 0.0, 0.0, 0.0]]
    file = tmp_path / "poses.json"
    file.write_text(json.dumps(poses))
    result = CliRunner().invoke(command, [str(FULL), "--poses", str(file)])
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    assert list(found) == ["joint_1", "joint_2", "joint_3"]
    assert found["joint_2"] == true_inertia(load_scenario(FULL), "joint_2", poses).tolist()


@pytest.mark.parametrize(("text", "reason"), [("{", "not a list of poses"), ("[[0, 1]]", "(1, 2)"), ("7", "poses")])
def test_bad_poses(command: typer.Typer, tmp_path: Path, text: str, reason: str) -> None:
    file = tmp_path / "poses.json"
    file.write_text(text)
    result = CliRunner().invoke(command, [str(FULL), "--poses", str(file)])
    assert result.exit_code == 2
    assert result.stdout == ""
    assert reason in result.stderr
    assert result.stderr.count("\n") == 1
