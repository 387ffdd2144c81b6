"""`sweepid estimate benefit` as a person calls it."""

import json
from pathlib import Path

import pytest
import yaml

from service.benefit import Benefit
from service.store.files.bundle import write_bundle
from tests.command import carried_out, refused, sweepid
from tests.unit.service.benefit import pair


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("worth") / "bundle"
    write_bundle(path, pair.robot(), pair.sweeps([0.0, 0.3, 0.6, 0.2, 0.9, 0.5, 0.1, 0.8]))
    return path


def side_file(folder: Path, text: str) -> Path:
    """The pair's own robot file with another URDF."""
    (folder / "cad.urdf").write_text(text)
    description = pair.robot().description.model_dump(mode="json") | {"urdf": "cad.urdf"}
    (folder / "cad.yaml").write_text(yaml.safe_dump(description))
    return folder / "cad.yaml"


def test_a_table_for_people_in_80_columns_without_a_shortened_word(bundle: Path) -> None:
    done = sweepid("estimate", "benefit", str(bundle))
    assert done.returncode == 0, done.stderr
    told = " ".join(done.stdout.split())
    for words in ("CAD", "estimate", "j1: 2 sweeps in 2 of 8 poses held out (every 4th)", "one false alarm in 8 h"):
        assert words in told
    assert max(len(line) for line in done.stdout.splitlines()) <= 80
    assert "…" not in told
    assert "times less" not in told


def test_json_alone_on_stdout(bundle: Path) -> None:
    told = carried_out("estimate", "benefit", str(bundle), "--json", "-")
    found = Benefit.read(json.loads(told), "benefit")
    assert found.axes["j1"].held_out == ("0004", "0008")
    assert found.axes["j1"].cad.inertia_percent.value > 20
    assert found.as_json() == json.loads(told)


def test_cad_may_come_from_a_file(bundle: Path, tmp_path: Path) -> None:
    right = pair.URDF.replace(
        '<link name="slide">\n    <inertial><mass value="1"/>', '<link name="slide">\n    <inertial><mass value="2"/>'
    )
    told = carried_out("estimate", "benefit", str(bundle), "--robot", str(side_file(tmp_path, right)), "--json", "-")
    assert Benefit.read(json.loads(told), "benefit").axes["j1"].cad.inertia_percent.value < 0.05


def test_cad_of_another_robot_is_refused(bundle: Path, root: Path) -> None:
    assert "emps.yaml: has joints slide, but the robot of the bundle has j1, j2" in refused(
        "estimate", "benefit", str(bundle), "--robot", str(root / "config/robots/emps.yaml")
    )


def test_too_few_poses_are_told(tmp_path: Path) -> None:
    write_bundle(tmp_path / "bundle", pair.robot(), pair.sweeps([0.0, 0.3, 0.6]))
    assert "has no axis that can be evaluated: j1 has sweeps in 3 poses; every 4th is held out" in refused(
        "estimate", "benefit", str(tmp_path / "bundle")
    )
