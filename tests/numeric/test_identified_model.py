"""A measured campaign to a robot in other tools: their mass matrices have the identified inertias on the diagonal."""

from typing import Any

import mujoco as untyped
import numpy as np
import pinocchio as pin
import pytest
from pydantic import JsonValue

from service.export import IdentifiedModel, identified_model, model_files
from service.identification import Estimate, as_document, identify
from service.identification.model.physical_consistency import is_physical
from tests.numeric.campaign import AXES, measure

mujoco: Any = untyped  # a compiled module without types
POSES = 40


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    """Axes 1 to 3 measured in 16 poses, the wrist locked."""
    campaign = measure("max100-full", 5, poses=16)
    return identify(campaign.robot, campaign.spectra)


@pytest.fixture(scope="module")
def document(estimate: Estimate) -> dict[str, JsonValue]:
    return as_document(estimate, estimate.workspace[:50]).as_json()


@pytest.fixture(scope="module")
def model(estimate: Estimate, document: dict[str, object]) -> IdentifiedModel:
    return identified_model(estimate.robot, document)


def test_all_links_and_motors_are_physical(model: IdentifiedModel, estimate: Estimate) -> None:
    assert [body.link for body in model.bodies] == [f"link_{k}" for k in range(1, 7)]  # those of the locked wrist too
    assert is_physical(np.array([body.parameters for body in model.bodies])).all()
    assert (model.motor_inertias > 0).all()
    # what no sweep told stays at the data sheet's: the motors of the wrist
    nominal = [axis.reflected_motor_inertia for axis in estimate.robot.axes[3:]]
    assert model.motor_inertias[3:] == pytest.approx(nominal)
    print(f"deviation of the nearest physical robot: {model.deviation_in_std} standard deviations")


def test_other_tools_have_the_identified_inertias(model: IdentifiedModel, estimate: Estimate) -> None:
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
    assert model.deviation_in_std == 0
    for name, found in (("MuJoCo", in_mujoco), ("Pinocchio", in_pinocchio)):
        print(f"{name}: M_kk differs from the identified J by at most {np.abs(found / identified - 1).max():.1e}")
        np.testing.assert_allclose(found, identified, rtol=1e-6)


def test_base_parameters_speak_of_the_robot(document: dict[str, object]) -> None:
    words = [parameter["symbolic"] for parameter in document["base_parameters"]]  # type: ignore[index, union-attr]
    assert "Iyy(link_2) + m(link_3) l2^2 + Jm(joint_2) - Jm(joint_3)" in words
    assert document["symbols"]["l2"]["value"] == 1.15  # type: ignore[index]
