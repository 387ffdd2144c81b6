"""Scenario files: what is shipped loads, what is wrong is refused with file and field."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from simulator import Scenario, ScenarioError, load_scenario

CONFIG = Path(__file__).parents[3] / "config"


@pytest.fixture
def edited(tmp_path: Path) -> Callable[[str, str], Path]:
    """A copy of the full scenario, beside a copy of its robot, with one text replaced."""
    shutil.copytree(CONFIG / "robots", tmp_path / "robots")
    (tmp_path / "scenarios").mkdir()

    def edit(old: str, new: str) -> Path:
        text = (CONFIG / "scenarios" / "max100-full.yaml").read_text()
        assert old in text
        path = tmp_path / "scenarios" / "edited.yaml"
        path.write_text(text.replace(old, new))
        return path

    return edit


@pytest.mark.parametrize("name", ["full", "rigid", "misfit"])
def test_shipped_scenarios(scenario: Callable[[str], Scenario], name: str) -> None:
    loaded = scenario(name)
    assert loaded.name == f"max100-{name}"
    assert list(loaded.axes) == ["joint_1", "joint_2", "joint_3"]
    assert all(axis.load_encoder for axis in loaded.axes.values())


def test_motors_are_five_percent_off(scenario: Callable[[str], Scenario]) -> None:
    loaded = scenario("full")
    for joint, axis in loaded.axes.items():
        assert axis.train.motor_inertia == pytest.approx(1.05 * loaded.nominal(joint).motor_inertia)


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("effort_noise", "efort_noise", "measurement.efort_noise"),
        ("stiffness: 7.4e5", "stiffness: -1", "axes.joint_1.train.spring.stiffness"),
        ("  joint_3:", "  joint_9:", "joint_9"),
        ("spring: {stiffness: 4.2e5, damping: 300.0}", "spring: null", "every axis has a spring or none"),
        ("max100-class.yaml", "nowhere.yaml", "nowhere.yaml: cannot be read"),
        ("robot: ../robots/max100-class.yaml", "robot: /dev/zero", "is larger than"),
    ],
)
def test_bad_scenarios_are_refused(edited: Callable[[str, str], Path], old: str, new: str, named: str) -> None:
    with pytest.raises(ScenarioError) as refused:
        load_scenario(edited(old, new))
    assert named in str(refused.value)


def test_locked_and_unknown_joints(scenario: Callable[[str], Scenario]) -> None:
    with pytest.raises(ScenarioError, match="joint_4"):
        scenario("full").driven("joint_4")
    with pytest.raises(ScenarioError, match="elbow"):
        scenario("full").nominal("elbow")


def test_a_robot_file_that_is_not_complete_is_named_itself(edited: Callable[[str, str], Path]) -> None:
    """As `sweepid robot check` drafts it: the fault is not in the scenario."""
    path = edited("name: max100-full", "name: mine")
    side = path.parents[1] / "robots" / "max100-class.yaml"
    content = yaml.safe_load(side.read_text("utf-8"))
    content["axes"][0]["motor_inertia"] = None
    side.write_text(yaml.safe_dump(content), "utf-8")
    with pytest.raises(ScenarioError, match=r"robots/max100-class\.yaml: axes\.0\.motor_inertia: .*needs every value"):
        load_scenario(path)
