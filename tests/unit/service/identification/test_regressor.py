"""The rows against Pinocchio (an independent code), on random chains with fixed, revolute and prismatic joints."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.stats import qmc

from service.identification.model import (
    JointMotion,
    axis_rows,
    condition_number,
    dynamics_names,
    dynamics_rows,
    fold,
    gravity_rows,
    gravity_terms,
    inertia_rows,
    link_rows,
    lock,
    parameter_names,
    reduce_columns,
    spread_evenly,
)
from service.identification.model.base_parameters import base_parameters
from service.model import read_chain
from tests.random_chain import random_urdf

GRAVITY = np.array([0.0, 0.0, -9.81])


@pytest.mark.parametrize("seed", range(1000, 1050))
def test_inertia_rows_and_rank_are_pinocchios(seed: int) -> None:
    """Of robots of 3 to 7 axes, of which three in ten slide."""
    rng, joints = np.random.default_rng(seed), 3 + seed % 5
    text = random_urdf(rng, joints, prismatic=0.3)
    chain, model = read_chain(text), pin.buildModelFromXML(text)
    model.gravity.linear = np.zeros(3)
    data, poses, still = model.createData(), rng.uniform(-2.5, 2.5, (40, joints)), np.zeros(joints)
    # unit acceleration from standstill without gravity: row k of the torque regressor is the inertia row
    units = list(enumerate(np.eye(joints)))
    expected = np.array(
        [[pin.computeJointTorqueRegressor(model, data, q, still, unit)[k].copy() for k, unit in units] for q in poses]
    )
    own = np.stack([inertia_rows(chain, k, poses) for k in range(joints)], 1)
    assert np.abs(own - expected).max() < 1e-12 * np.abs(expected).max()
    motors = np.broadcast_to(np.eye(joints), (len(poses), joints, joints))  # that of axis k is in the rows of axis k
    rows = np.concatenate([expected, motors], -1).reshape(len(poses) * joints, -1)
    assert len(base_parameters(chain, tuple(range(joints))).columns) == np.linalg.matrix_rank(rows, tol=1e-7)


@pytest.mark.parametrize("seed", range(300, 312))
def test_gravity_is_pinocchios_also_where_the_axis_has_turned(seed: int) -> None:
    """Linear in the links; a slide carries the weight along it."""
    rng, turn = np.random.default_rng(seed), 0.3
    text = random_urdf(rng, 4, prismatic=0.35)
    chain, model = read_chain(text), pin.buildModelFromXML(text)
    model.gravity.linear = GRAVITY
    data, poses, parameters = model.createData(), rng.uniform(-2.5, 2.5, (3, model.nv)), chain.inertial.ravel()
    for k, joint in enumerate(chain.joints):
        rows = gravity_rows(chain, GRAVITY, k, poses) @ parameters
        terms = gravity_terms(chain, parameters, GRAVITY, k, poses)
        turned = poses + (turn * np.eye(model.nv)[k] if joint.kind == "revolute" else 0.0)
        expected = np.array([pin.computeGeneralizedGravity(model, data, pose)[k] for pose in turned])
        if joint.kind == "prismatic":
            np.testing.assert_allclose(rows, np.column_stack([expected, np.zeros(3)]), rtol=1e-9, atol=1e-9)
            assert not np.any(terms)
            continue
        for torque, stiffness in (rows.T, terms.T):
            found = torque * np.cos(turn) + stiffness * np.sin(turn)
            np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-9)


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


OBLIQUE = np.array([0.3, -1.2, -9.81])


def motion(rng: np.random.Generator, samples: int, joints: int) -> JointMotion:
    return JointMotion(*rng.uniform(-2.5, 2.5, (3, samples, joints)))


@pytest.mark.parametrize("seed", range(10))
def test_link_rows_are_pinocchios(seed: int) -> None:
    rng = np.random.default_rng(300 + seed)
    text = random_urdf(rng, int(rng.integers(1, 8)))
    chain, model = read_chain(text), pin.buildModelFromXML(text)
    model.gravity.linear = OBLIQUE
    data = model.createData()
    moved = motion(rng, 4, model.nv)
    rows = link_rows(chain, OBLIQUE, moved)
    effort = rows @ chain.inertial.ravel()
    for k, (q, v, a) in enumerate(zip(moved.position, moved.velocity, moved.acceleration, strict=True)):
        expected = np.atleast_2d(pin.computeJointTorqueRegressor(model, data, q, v, a))
        np.testing.assert_allclose(rows[k], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
        torque = pin.rnea(model, data, q, v, a)
        np.testing.assert_allclose(effort[k], torque, rtol=1e-9, atol=1e-9 * np.abs(torque).max())


def test_the_drive_by_hand() -> None:
    chain = read_chain(random_urdf(np.random.default_rng(2), 2))
    still = JointMotion(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 2)))
    motor = JointMotion(np.zeros((1, 2)), np.array([[0.5, -2.0]]), np.array([[3.0, 0.0]]))
    names = dynamics_names(chain)
    values = np.zeros(28)
    for name, value in (("Jm(joint_1)", 2.0), ("Fv(joint_2)", 10.0), ("Fc(joint_2)", 7.0), ("offset(joint_1)", 1.0)):
        values[names.index(name)] = value
    # joint 1: 2 * 3 + 1; joint 2: 10 * -2 - 7
    assert dynamics_rows(chain, OBLIQUE, still, motor)[0] @ values == pytest.approx([7.0, -27.0])


@pytest.mark.parametrize("dimensions", [1, 2, 6, 12])
def test_the_points_are_those_of_scipy_to_the_last_digit(dimensions: int) -> None:
    lower = -np.linspace(0.5, 3.0, dimensions)
    upper = np.linspace(1.0, 2.0, dimensions)
    expected = qmc.scale(qmc.Halton(dimensions, scramble=False).random(1000), lower, upper)
    np.testing.assert_array_equal(spread_evenly(1000, lower, upper), expected)
