"""A measured campaign to a robot in other tools: their mass matrices have the identified inertias on the diagonal."""

from typing import Any

import mujoco as untyped
import numpy as np
import pinocchio as pin
import pytest
from pydantic import JsonValue

from service.formats.export import IdentifiedModel, identified_model, model_files
from service.identification.estimates.document import as_document
from service.identification.estimates.estimate import RobotEstimate, identify
from service.identification.model import gravity_rows
from service.identification.model.physical_consistency import is_physical
from simulator.rigid_body import RigidBody
from tests.numeric.campaign import AXES, measure, scenario_named

mujoco: Any = untyped  # a compiled module without types
POSES = 40


@pytest.fixture(scope="module")
def estimate() -> RobotEstimate:
    """Axes 1 to 3 measured in 16 poses, the wrist locked."""
    campaign = measure("max100-full", 5, poses=16)
    return identify(campaign.robot, campaign.spectra)


@pytest.fixture(scope="module")
def document(estimate: RobotEstimate) -> dict[str, JsonValue]:
    return as_document(estimate, estimate.workspace[:50]).as_json()


@pytest.fixture(scope="module")
def model(estimate: RobotEstimate, document: dict[str, object]) -> IdentifiedModel:
    return identified_model(estimate.robot, document)


def test_all_links_and_motors_are_physical(model: IdentifiedModel, estimate: RobotEstimate) -> None:
    assert [body.link for body in model.bodies] == [f"link_{k}" for k in range(1, 7)]  # those of the locked wrist too
    assert is_physical(np.array([body.parameters for body in model.bodies])).all()
    assert (model.motor_inertias > 0).all()
    # what no sweep told stays at the data sheet's: the motors of the wrist
    nominal = [axis.reflected_motor_inertia for axis in estimate.robot.axes[3:]]
    assert model.motor_inertias[3:] == pytest.approx(nominal)
    print(f"deviation of the nearest physical robot: {model.deviation_in_std} standard deviations")


def test_other_tools_have_the_identified_inertias(model: IdentifiedModel, estimate: RobotEstimate) -> None:
    files = model_files(model)
    mjcf, urdf = mujoco.MjModel.from_xml_string(files["model.xml"]), pin.buildModelFromXML(files["model.urdf"])
    state, data = mujoco.MjData(mjcf), urdf.createData()
    poses = estimate.workspace[:POSES]  # the wrist as it was locked
    identified = np.stack([estimate.identified(joint, poses) for joint in AXES], -1)
    full = np.zeros((6, 6))
    in_mujoco, in_pinocchio = [], []
    for pose in poses:
        state.qpos[:] = pose
        mujoco.mj_forward(mjcf, state)
        mujoco.mj_fullM(mjcf, state, full)
        in_mujoco.append(np.diag(full)[:3].copy())
        in_pinocchio.append((np.diag(pin.crba(urdf, data, pose)) + model.motor_inertias)[:3])
    np.testing.assert_allclose(in_mujoco, in_pinocchio, rtol=1e-6)
    off = np.sqrt(np.mean((np.array(in_mujoco) - identified) ** 2, axis=0))
    for joint, one, worth in zip(AXES, off, model.worth, strict=False):
        print(f"{joint}: M_kk differs from the identified J by {one:.3g} RMS, expected error {worth.inertia.error:.3g}")
        assert one < worth.inertia.error


def test_the_exported_gravity_is_better_than_cads(model: IdentifiedModel, estimate: RobotEstimate) -> None:
    """The links with exactly these base parameters would have 440 kg for 178 kg, and twice CAD's error of gravity."""
    true, robot = RigidBody(scenario_named("max100-full")), estimate.robot
    poses = estimate.workspace[:POSES]
    parameters = np.ravel([body.parameters for body in model.bodies])
    for joint in AXES[1:]:
        k = robot.index(joint)
        rows = gravity_rows(robot.chain, robot.gravity, k, poses)[:, 0]
        held = np.array([true.gravity(k, pose).at(float(pose[k])) for pose in poses])
        models = parameters, robot.chain.inertial.ravel()
        error, of_cad = (float(np.sqrt(np.mean((rows @ links - held) ** 2))) for links in models)
        worth = model.worth[k].gravity
        print(f"{joint}: gravity off by {error:.3g} N m, CAD's by {of_cad:.3g}, expected {worth.error:.3g}")
        assert error < min(of_cad, 2 * worth.error)
