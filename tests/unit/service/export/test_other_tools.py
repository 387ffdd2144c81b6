"""The exported robot, loaded in MuJoCo and in Pinocchio, turns as the estimate says."""

from collections.abc import Callable
from typing import Any, cast

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from service.formats.export import IdentifiedModel, identified_model, model_files
from service.identification.model import axis_rows
from service.model import Robot
from tests.unit.service.export.conftest import estimate_of

_mujoco = cast(Any, mujoco)  # a binary module without type stubs


@pytest.fixture(params=["max100", *range(6)])
def model(request: pytest.FixtureRequest, max100: Robot, random_robot: Callable[[int], Robot]) -> IdentifiedModel:
    """A robot whose links and motors were found to be other than in the nominal model."""
    robot = max100 if request.param == "max100" else random_robot(request.param)
    rng = np.random.default_rng(17)
    links = robot.chain.inertial * rng.uniform(0.7, 1.4, (len(robot.axes), 1))
    motors = rng.uniform(5, 60, len(robot.axes))
    return identified_model(robot, estimate_of(robot, links, motors))


def expected(model: IdentifiedModel, poses: np.ndarray) -> np.ndarray:
    """(m, n) inertia about each axis by our own rows."""
    parameters = np.concatenate([np.ravel([body.parameters for body in model.bodies]), model.motor_inertias])
    chain = model.robot.chain
    return np.stack([axis_rows(chain, k, poses) @ parameters for k in range(len(chain.joints))], -1)


def poses_of(model: IdentifiedModel) -> np.ndarray:
    return np.random.default_rng(3).uniform(-2.5, 2.5, (20, len(model.robot.axes)))


def mass_matrix(loaded: Any, names: tuple[str, ...], pose: np.ndarray) -> np.ndarray:
    data = _mujoco.MjData(loaded)
    data.qpos[[int(loaded.joint(name).qposadr[0]) for name in names]] = pose
    _mujoco.mj_forward(loaded, data)
    full = np.zeros((loaded.nv, loaded.nv))
    _mujoco.mj_fullM(loaded, data, full)
    return full


def test_each_file_has_the_inertias_about_every_axis(model: IdentifiedModel) -> None:
    files, poses, motors = model_files(model), poses_of(model), model.motor_inertias
    wanted = expected(model, poses)
    urdf = pin.buildModelFromXML(files["model.urdf"])
    assert tuple(urdf.names[1:]) == model.robot.joints
    data = urdf.createData()
    np.testing.assert_allclose([np.diag(pin.crba(urdf, data, pose)) + motors for pose in poses], wanted, rtol=1e-9)
    for name, more in (("model.urdf", motors), ("model.xml", 0 * motors)):  # a URDF has no place for motors
        loaded = _mujoco.MjModel.from_xml_string(files[name])
        found = [np.diag(mass_matrix(loaded, model.robot.joints, pose)) + more for pose in poses]
        np.testing.assert_allclose(found, wanted, rtol=1e-6, err_msg=name)


def test_mjcf_has_friction_limits_and_gravity(model: IdentifiedModel) -> None:
    loaded = _mujoco.MjModel.from_xml_string(model_files(model)["model.xml"])
    first = loaded.joint(model.robot.joints[0])
    assert loaded.dof_damping[first.dofadr[0]] == 150.5  # the median of its sweeps
    assert not loaded.dof_damping[1:].any()  # only the first axis was measured
    limits = [(joint.lower, joint.upper) for joint in model.robot.chain.joints]
    np.testing.assert_allclose([loaded.joint(name).range for name in model.robot.joints], limits)
    np.testing.assert_allclose(loaded.opt.gravity, model.robot.gravity)


def test_gravity_is_that_of_pinocchio(model: IdentifiedModel) -> None:
    """The whole first moments of all links, not only what turns about one axis."""
    urdf = pin.buildModelFromXML(model_files(model)["model.urdf"])
    urdf.gravity.linear = model.robot.gravity
    loaded, data = _mujoco.MjModel.from_xml_string(model_files(model)["model.xml"]), urdf.createData()
    state = _mujoco.MjData(loaded)
    for pose in poses_of(model)[:5]:
        state.qpos[:] = pose
        _mujoco.mj_forward(loaded, state)
        held = pin.computeGeneralizedGravity(urdf, data, pose)
        np.testing.assert_allclose(state.qfrc_bias, held, rtol=1e-6, atol=1e-6 * np.abs(held).max())
