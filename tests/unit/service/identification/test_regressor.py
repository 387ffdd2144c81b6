"""The rows against Pinocchio (an independent code), on random chains with fixed, revolute and prismatic joints."""

import numpy as np
import pinocchio as pin
import pytest

from service.identification.model.base_parameters import base_parameters, condition_number, reduce_columns
from service.identification.model.regressor import (
    axis_rows,
    fold,
    gravity_rows,
    gravity_terms,
    inertia_rows,
    lock,
    parameter_names,
)
from service.urdf import read_chain
from tests.random_chain import random_urdf

GRAVITY = np.array([0.0, 0.0, -9.81])


@pytest.mark.parametrize("seed", range(8))
def test_inertia_about_an_axis_is_the_mass_matrix_diagonal(seed: int) -> None:
    rng = np.random.default_rng(seed)
    text = random_urdf(rng, int(rng.integers(1, 8)))
    chain, model = read_chain(text), pin.buildModelFromXML(text)
    data = model.createData()
    poses = rng.uniform(-2.5, 2.5, (4, model.nv))
    for k in range(model.nv):
        inertia = inertia_rows(chain, k, poses) @ chain.inertial.ravel()
        expected = [pin.crba(model, data, q)[k, k] for q in poses]
        np.testing.assert_allclose(inertia, expected, rtol=1e-11)


@pytest.mark.parametrize("seed", range(8))
def test_gravity_torque_turns_with_the_axis(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    text = random_urdf(rng, 4, prismatic=0.2)
    chain, model = read_chain(text), pin.buildModelFromXML(text)
    model.gravity.linear = GRAVITY
    data = model.createData()
    pose, turn = rng.uniform(-2.5, 2.5, model.nv), 0.3
    for k in range(model.nv):
        torque, stiffness = gravity_terms(chain, chain.inertial.ravel(), GRAVITY, k, pose)[0]
        if chain.joints[k].kind == "prismatic":
            assert torque == stiffness == 0.0
            continue
        turned = pose.copy()
        turned[k] += turn
        expected = pin.computeGeneralizedGravity(model, data, turned)[k]
        assert torque * np.cos(turn) + stiffness * np.sin(turn) == pytest.approx(expected, rel=1e-10, abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_gravity_is_linear_in_the_links(seed: int) -> None:
    """The rows give the terms of any links; a prismatic axis needs the weight along it, as Pinocchio says."""
    rng = np.random.default_rng(300 + seed)
    text = random_urdf(rng, 4, prismatic=0.5)
    chain, model = read_chain(text), pin.buildModelFromXML(text)
    model.gravity.linear = GRAVITY
    data, poses = model.createData(), rng.uniform(-2.5, 2.5, (3, model.nv))
    parameters = chain.inertial.ravel()
    for k in range(model.nv):
        rows = gravity_rows(chain, GRAVITY, k, poses) @ parameters
        if chain.joints[k].kind == "prismatic":
            expected = [pin.computeGeneralizedGravity(model, data, pose)[k] for pose in poses]
            np.testing.assert_allclose(rows, np.column_stack([expected, np.zeros(3)]), rtol=1e-9, atol=1e-9)
        else:
            np.testing.assert_allclose(rows, gravity_terms(chain, parameters, GRAVITY, k, poses), rtol=1e-9, atol=1e-9)


def test_a_lift_carries_its_weight() -> None:
    text = """<robot name="r"><link name="base"/><link name="table"><inertial><mass value="7"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
    <joint name="z" type="prismatic"><parent link="base"/><child link="table"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"""
    chain = read_chain(text)
    rows = gravity_rows(chain, GRAVITY, 0, np.array([[0.3]]))[0] @ chain.inertial.ravel()
    assert rows == pytest.approx([7 * 9.81, 0.0])


def test_a_locked_joint_changes_no_inertia() -> None:
    rng = np.random.default_rng(5)
    chain = read_chain(random_urdf(rng, 6))
    poses = rng.uniform(-2, 2, (5, 6))
    poses[:, [0, 3, 5]] = [0.4, -0.7, 1.1]
    locked = lock(chain, {0: 0.4, 3: -0.7, 5: 1.1})
    left = [1, 2, 4]
    for own, k in enumerate(left):
        np.testing.assert_allclose(
            inertia_rows(locked, own, poses[:, left]) @ locked.inertial.ravel(),
            inertia_rows(chain, k, poses) @ chain.inertial.ravel(),
            rtol=1e-11,
        )


def test_point_mass_on_an_arm_by_hand() -> None:
    # 3 kg at 2 m from a vertical axis: J = 3 * 2^2; about a horizontal axis it also needs 3 g 2 cos q to be held
    text = """<robot name="r"><link name="base"/><link name="arm"><inertial><origin xyz="2 0 0"/><mass value="3"/>
    <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
    <joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 -1 0"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"""
    chain = read_chain(text)
    assert (inertia_rows(chain, 0, np.zeros((1, 1))) @ chain.inertial.ravel())[0] == pytest.approx(12.0)
    torque, stiffness = gravity_terms(chain, chain.inertial.ravel(), GRAVITY, 0, np.array([[0.5]]))[0]
    assert torque == pytest.approx(3 * 9.81 * 2 * np.cos(0.5))
    assert stiffness == pytest.approx(-3 * 9.81 * 2 * np.sin(0.5))


@pytest.mark.parametrize("seed", range(6))
def test_rank_is_that_of_pinocchios_regressor(seed: int) -> None:
    rng = np.random.default_rng(200 + seed)
    joints = int(rng.integers(2, 7))
    text = random_urdf(rng, joints)
    chain, model = read_chain(text), pin.buildModelFromXML(text)
    model.gravity.linear = np.zeros(3)
    data = model.createData()
    rows = []
    for _ in range(60):
        pose = rng.uniform(-2.5, 2.5, joints)
        for k in range(joints):
            unit = np.eye(joints)[k]
            # unit acceleration from standstill without gravity: row k of the torque regressor is the inertia row
            regressor = pin.computeJointTorqueRegressor(model, data, pose, np.zeros(joints), unit)[k]
            rows.append(np.concatenate([regressor, unit]))  # and the motor inertia of axis k
    assert len(base_parameters(chain, tuple(range(joints))).names) == np.linalg.matrix_rank(np.array(rows), tol=1e-7)


def test_base_parameters_carry_the_whole_inertia() -> None:
    rng = np.random.default_rng(9)
    chain = read_chain(random_urdf(rng, 5))
    base = base_parameters(chain, (0, 2, 4))
    parameters = np.concatenate([chain.inertial.ravel(), rng.uniform(1, 50, 5)])
    poses = rng.uniform(-2.5, 2.5, (30, 5))
    for k in (0, 2, 4):
        np.testing.assert_allclose(
            base.rows(chain, k, poses) @ (base.combination @ parameters),
            axis_rows(chain, k, poses) @ parameters,
            rtol=1e-9,
            atol=1e-9,
        )
    assert len(set(base.names)) == len(base.names)
    assert all(name.split(" ")[0] in parameter_names(chain) for name in base.names)


def test_a_tall_matrix_has_the_base_of_a_short_one() -> None:
    """The columns' lengths and angles alone count: rows that are mixed among one another change nothing."""
    rng = np.random.default_rng(9)
    chain = read_chain(random_urdf(rng, 3))
    rows = axis_rows(chain, 1, rng.uniform(-2.0, 2.0, (300, 3)))
    names = parameter_names(chain)
    tall, short = (
        reduce_columns(rows, names),
        reduce_columns(np.asarray(np.linalg.qr(rows, mode="r"), dtype=float), names),
    )
    assert len(rows) > rows.shape[1]
    assert tall.columns == short.columns
    np.testing.assert_allclose(rows[:, list(tall.columns)] @ tall.combination, rows, atol=1e-9 * np.abs(rows).max())
    np.testing.assert_allclose(tall.combination, short.combination, atol=1e-9 * np.abs(tall.combination).max())


def test_condition_number_is_that_of_unit_columns() -> None:
    assert condition_number(np.diag([1.0, 1000.0])) == pytest.approx(1.0)
    assert condition_number(np.array([[1.0, 1.0], [0.0, 1.0]])) == pytest.approx(
        np.linalg.cond([[1.0, 2**-0.5], [0.0, 2**-0.5]])
    )
    assert condition_number(np.ones((3, 2))) == np.inf


def test_folding_is_what_locking_does() -> None:
    rng = np.random.default_rng(2)
    chain = read_chain(random_urdf(rng, 5))
    fixed = {0: 0.3, 2: -0.4, 4: 0.2}
    motors = rng.uniform(1, 2, 5)
    folded = fold(chain, fixed) @ np.concatenate([chain.inertial.ravel(), motors])
    np.testing.assert_allclose(folded, [*lock(chain, fixed).inertial.ravel(), *motors[[1, 3]]], atol=1e-12)
