"""The representative robot: accepted by the service, physically possible, with collision shapes that mean something."""

from pathlib import Path
from typing import Any, cast

import mujoco
import numpy as np
import pytest
import yaml

from service.robot import RobotDescription, build_robot
from service.urdf import inertia_matrix, transform_inertial

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


def test_the_service_accepts_the_side_file_and_it_fits_the_urdf() -> None:
    description = RobotDescription.model_validate(yaml.safe_load((ROBOTS / "max100-class.yaml").read_text()))
    robot = build_robot(description, (ROBOTS / description.urdf).read_text())
    assert robot.joints == tuple(f"joint_{k}" for k in range(1, 7))
    for axis, joint in zip(robot.axes, robot.chain.joints, strict=True):
        assert axis.rated_effort <= joint.effort


def test_every_link_could_be_a_real_body() -> None:
    description = RobotDescription.model_validate(yaml.safe_load((ROBOTS / "max100-class.yaml").read_text()))
    for parameters in build_robot(description, URDF.read_text()).chain.inertial:
        centre = parameters[1:4] / parameters[0]
        moments = np.linalg.eigvalsh(inertia_matrix(transform_inertial(parameters, np.eye(3), -centre)))
        assert moments[0] > 0
        assert moments[2] < moments[0] + moments[1]


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
