"""`sweepid export model` as a person calls it: from a bundle or an estimate to files that other tools load."""

import json
from pathlib import Path
from typing import Any, cast

import mujoco
import pytest

from service.configuration import read_robot
from tests.command import carried_out, refused, sweepid
from tests.unit.service.cli.test_identify import bundle

_mujoco = cast(Any, mujoco)  # a binary module without type stubs

__all__ = ["bundle"]  # the fixture

FILES = {"model.urdf", "model.xml", "model.yaml", "robot.yaml"}


@pytest.fixture
def side_file(bundle: Path, tmp_path: Path) -> Path:
    """The bundle's robot as a side file beside its URDF, as a cell has it."""
    description = json.loads((bundle / "bundle.json").read_text())["robot"]
    path = tmp_path / "pair.yaml"
    path.write_text(json.dumps(description | {"urdf": str(bundle / "robot.urdf")}))  # JSON is YAML
    return path


def test_from_a_bundle(bundle: Path, tmp_path: Path) -> None:
    assert carried_out("export", "model", str(bundle), str(tmp_path / "out")) == f"{tmp_path / 'out'}\n"
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES
    assert _mujoco.MjModel.from_xml_path(str(tmp_path / "out/model.xml")).dof_damping[0] == pytest.approx(4.0, rel=0.01)
    again = read_robot(tmp_path / "out/robot.yaml")
    assert again.axes[0].viscous_friction == pytest.approx(4.0, rel=0.01)
    assert again.axes[1].motor_inertia is None  # unknown, and not measured


def test_from_an_estimate(bundle: Path, side_file: Path, tmp_path: Path) -> None:
    estimate = tmp_path / "estimate.json"
    assert sweepid("identify", str(bundle), "--json", str(estimate)).returncode == 0
    assert sweepid("export", "model", str(bundle), str(tmp_path / "one")).returncode == 0
    carried_out("export", "model", str(estimate), str(tmp_path / "two"), "--robot", str(side_file))
    for name in FILES:
        assert (tmp_path / "one" / name).read_text() == (tmp_path / "two" / name).read_text()


def test_what_cannot_be_exported_is_told(bundle: Path, side_file: Path, tmp_path: Path) -> None:
    (tmp_path / "no.json").write_text("[1]")
    (tmp_path / "other.json").write_text("{}")
    for arguments, reason in (
        (["no.json", "out"], "--robot: is required with an estimate"),
        (["no.json", "out", "--robot", str(side_file)], "no.json: is not a JSON object"),
        (["other.json", "out", "--robot", str(side_file)], "other.json.axes: Field required"),
        (["missing.json", "out", "--robot", str(side_file)], "missing.json: cannot be read"),
        ([str(bundle), "."], "exists already and is not an empty folder"),
    ):
        places = [str(tmp_path / part) if part.endswith((".json", "out", ".")) else part for part in arguments[:2]]
        assert reason in refused("export", "model", *places, *arguments[2:]).splitlines()[-1]
        assert not (tmp_path / "out").exists()
