"""The rows of all efforts against Pinocchio (an independent code), on random chains, revolute and prismatic."""

import numpy as np
import pinocchio as pin
import pytest

from service.identification.model.inverse_dynamics import JointMotion, dynamics_names, dynamics_rows, link_rows
from service.identification.model.regressor import axis_rows
from service.model.urdf import read_chain
from tests.random_chain import random_urdf

GRAVITY = np.array([0.3, -1.2, -9.81])


def motion(rng: np.random.Generator, samples: int, joints: int) -> JointMotion:
    return JointMotion(*rng.uniform(-2.5, 2.5, (3, samples, joints)))


@pytest.mark.parametrize("seed", range(10))
def test_link_rows_are_pinocchios(seed: int) -> None:
    rng = np.random.default_rng(300 + seed)
    text = random_urdf(rng, int(rng.integers(1, 8)))
    chain, model = read_chain(text), pin.buildModelFromXML(text)
    model.gravity.linear = GRAVITY
    data = model.createData()
    moved = motion(rng, 4, model.nv)
    rows = link_rows(chain, GRAVITY, moved)
    effort = rows @ chain.inertial.ravel()
    for k, (q, v, a) in enumerate(zip(moved.position, moved.velocity, moved.acceleration, strict=True)):
        expected = np.atleast_2d(pin.computeJointTorqueRegressor(model, data, q, v, a))
        np.testing.assert_allclose(rows[k], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
        torque = pin.rnea(model, data, q, v, a)
        np.testing.assert_allclose(effort[k], torque, rtol=1e-9, atol=1e-9 * np.abs(torque).max())


def test_one_axis_from_standstill_without_gravity_is_the_inertia_row() -> None:
    rng = np.random.default_rng(1)
    chain = read_chain(random_urdf(rng, 5))
    pose = rng.uniform(-2, 2, (1, 5))
    for k in range(5):
        unit = JointMotion(pose, np.zeros((1, 5)), np.eye(5)[[k]])
        rows = dynamics_rows(chain, np.zeros(3), unit)[0, k, :55]
        np.testing.assert_allclose(rows, axis_rows(chain, k, pose)[0], atol=1e-12)


def test_the_drive_by_hand() -> None:
    chain = read_chain(random_urdf(np.random.default_rng(2), 2))
    still = JointMotion(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 2)))
    motor = JointMotion(np.zeros((1, 2)), np.array([[0.5, -2.0]]), np.array([[3.0, 0.0]]))
    names = dynamics_names(chain)
    values = np.zeros(28)
    for name, value in (("Jm(joint_1)", 2.0), ("Fv(joint_2)", 10.0), ("Fc(joint_2)", 7.0), ("offset(joint_1)", 1.0)):
        values[names.index(name)] = value
    # joint 1: 2 * 3 + 1; joint 2: 10 * -2 - 7
    assert dynamics_rows(chain, GRAVITY, still, motor)[0] @ values == pytest.approx([7.0, -27.0])
