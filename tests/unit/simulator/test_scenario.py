"""Scenario and robot files: what is shipped loads and is possible, what is wrong is refused with file and field."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import mujoco
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


_mujoco = cast(Any, mujoco)  # a binary module without type stubs

ROBOTS = Path(__file__).parents[3] / "config" / "robots"
URDF = ROBOTS / "max100-class.urdf"


@pytest.fixture(scope="module")
def model() -> Any:
    return _mujoco.MjModel.from_xml_path(str(URDF))


def contacts(model: Any, *positions: float) -> set[tuple[str, str]]:
    data = _mujoco.MjData(model)
    data.qpos[: len(positions)] = positions
    _mujoco.mj_forward(model, data)
    return {
        (model.body(model.geom_bodyid[c.geom1]).name, model.body(model.geom_bodyid[c.geom2]).name) for c in data.contact
    }


def test_every_link_has_a_collision_shape(model: Any) -> None:
    assert {model.body(body).name for body in model.geom_bodyid} == {"world", *(f"link_{k}" for k in range(1, 7))}


@pytest.mark.parametrize(
    ("pose", "pair"),
    [
        ((), None),
        ((0.0, 1.3, 0.9), ("world", "link_6")),  # tool into the floor
        ((0.0, 1.4, 0.6), ("world", "link_4")),  # forearm into the floor
        ((0.0, -0.5, 1.2, 0.0, 2.0), ("link_2", "link_6")),  # tool into the upper arm
    ],
)
def test_silly_poses_collide_and_at_rest_nothing_touches(
    model: Any, pose: tuple[float, ...], pair: tuple[str, str] | None
) -> None:
    found = {frozenset(each) for each in contacts(model, *pose)}
    assert found >= {frozenset(pair)} if pair else found == set()
