"""The rigid model of a pendulum by hand, and what is read out of a load that changed."""

import numpy as np
import pinocchio as pin
import pytest

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.rows.rigid import (
    Rigid,
    load_rows,
    nominal_load,
    nominal_parameters,
    parallelograms,
    parameter_spread,
    rigid,
)
from service.diagnosis.rows.signals import tracks
from service.identification.estimates.torque_gain import KnownMass
from service.model import Axis, Prior, Robot, RobotDescription
from tests.numeric.campaign import max100
from tests.unit.service.diagnosis.following import FORWARD, carrying, swept

MASS, ARM, MOTOR, G = 3.0, 2.0, 0.5, 9.81
POSES = np.array([[0.0], [0.5]])
URDF = f"""<robot name="pendulum"><link name="base"/><link name="arm"><inertial><origin xyz="{ARM} 0 0"/>
<mass value="{MASS}"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 -1 0"/>
<limit lower="-2" upper="2" velocity="1" effort="100"/></joint></robot>"""


def pendulum(prior: Prior | None = None) -> Robot:
    """A point mass on an arm that is level at 0 and turns upwards; the motor reflects MOTOR."""
    axis = Axis(joint="j", gear_ratio=10.0, motor_inertia=MOTOR / 100, rated_effort=100.0, viscous_friction=5.0)
    return Robot(RobotDescription(name="p", urdf="p.urdf", axes=(axis,), prior=prior or Prior()), URDF)


def model() -> Rigid:
    return rigid(pendulum(), "j", POSES, np.array([1.0, 1.0, 0.3]))


def test_the_load_of_a_pendulum() -> None:
    inertia, torque, slope = nominal_load(pendulum(), "j", POSES)
    assert inertia == pytest.approx(MASS * ARM**2 + MOTOR)
    assert torque == pytest.approx(MASS * G * ARM * np.cos(POSES[:, 0]))
    assert slope == pytest.approx(-MASS * G * ARM * np.sin(POSES[:, 0]))


def test_the_prior_is_that_of_each_parameter() -> None:
    prior = Prior(inertia=0.2, gravity=0.1, motor_inertia=0.05)
    sigma = np.diag(parameter_spread(pendulum(prior), 0, POSES))
    assert sigma[0] == pytest.approx(0.1 * MASS)
    assert sigma[1:4] == pytest.approx(0.1 * MASS * ARM)
    assert sigma[4:10] == pytest.approx(0.2 * MASS * ARM**2)
    assert sigma[10] == pytest.approx(0.05 * MOTOR)


def test_a_load_within_the_prior_costs_what_its_probability_says() -> None:
    """One sigma of the first moment alone, in units of the noise: about one, as no other parameter gives the same."""
    found = model()
    wanted = np.zeros((3, len(POSES)))
    wanted[1], wanted[2] = G * np.cos(POSES[:, 0]), -G * np.sin(POSES[:, 0])
    wanted *= 0.3 * MASS * ARM
    basis = found.basis.reshape(len(found.basis), -1)
    coefficients = np.asarray(np.linalg.lstsq(basis.T, wanted.ravel(), rcond=None)[0], dtype=float)
    np.testing.assert_allclose(found.load(coefficients) - found.nominal, wanted, atol=1e-3 * np.abs(wanted).max())
    assert coefficients @ found.precision @ coefficients == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize("name", ["gravity_error", "payload", "torque_constant_error"])
def test_what_an_effect_frees_costs_nothing_and_the_rest_what_it_did(name: str) -> None:
    """Along freed directions there is no penalty; beside them that of the best that they can add (Schur complement)."""
    found = model()
    directions, precision = found.freed[name], found.precision
    free = found.precision_without([name])
    scale = float(np.abs(precision).max())
    np.testing.assert_allclose(free @ directions, 0.0, atol=1e-8 * scale)
    values = np.linalg.eigvalsh(free)
    assert values.min() > -1e-8 * scale
    across = np.random.default_rng(1).normal(size=len(precision))
    inner = np.linalg.solve(directions.T @ precision @ directions, directions.T @ precision @ across)
    best = across - directions @ inner
    assert across @ free @ across == pytest.approx(best @ precision @ best, rel=1e-6, abs=1e-8 * scale)
    assert found.freedom(name) == directions.shape[1] == np.linalg.matrix_rank(directions)
    assert found.precision_without(["coulomb_friction"]) is precision  # what is no load frees nothing
    assert found.freedom("coulomb_friction") == 0


TURNED = np.array(
    [[0, -0.8, 0.3, 0, 0.4, 0], [0, 0.1, -0.5, 1.2, 0.7, 0], [0, 0.9, 0.9, -1.2, -0.7, 1], [0, 0.4, 0, 0, 1.2, 0]]
)


def test_a_point_mass_on_the_flange_gives_its_mass_and_moments() -> None:
    robot, mass = max100(), KnownMass(40.0, (0.2, 0.0, 0.1))
    motion = tracks(robot, "joint_2", swept("joint_2", TURNED, robot=robot, blocks=FORWARD, repeats=1))
    change = carrying(mass)(motion)
    readout = CATALOGUE["payload"].readout
    assert readout is not None
    told = readout(motion, change, np.eye(change.size) * 25.0)
    value, std, unit = told["mass"]
    assert unit == "kg"
    assert abs(value - mass.mass) < 3 * std
    assert value == pytest.approx(mass.mass, rel=0.1)
    # what mass and moments say pulls as the change does
    parameters = [told[name][0] for name in ("mass", "moment_x", "moment_y", "moment_z")]
    rows = load_rows(robot, robot.index("joint_2"), motion.poses)[:, robot.chain.inertial.size - 10 :][:, :4]
    again = (rows @ parameters).reshape(3, -1)
    np.testing.assert_allclose(again[1:], change[1:], atol=0.02 * np.abs(change[1:]).max())


def test_all_of_the_load_once_more_by_a_part_is_a_gain() -> None:
    robot = max100()
    motion = tracks(robot, "joint_2", swept("joint_2", TURNED, blocks=FORWARD, repeats=1))
    readout = CATALOGUE["torque_constant_error"].readout
    assert readout is not None
    change = 0.07 * nominal_load(robot, "joint_2", motion.poses)
    assert readout(motion, change, np.zeros((change.size, change.size)))["gain_error"][:2] == pytest.approx((0.07, 0.0))


@pytest.mark.parametrize("joint", ["joint_1", "joint_2", "joint_3", "joint_5"])
def test_the_load_with_a_parallelogram_is_that_of_the_joints_together(joint: str) -> None:
    """Pinocchio's inertia and gravity of the plain chain, by the positions s of the drives: q_3 = s_3 - s_2."""
    robot, index = max100(), max100().index(joint)
    (first, rows), *others = parallelograms(robot, index, TURNED).items()
    assert (first, others) == (robot.index("joint_2"), [])
    coupling = np.eye(6)
    coupling[2, 1] = -1.0
    model_ = pin.buildModelFromXML(robot.urdf_text)
    model_.gravity.linear = robot.gravity
    data = model_.createData()
    motor = robot.axis(joint).reflected_motor_inertia
    for pose, (inertia, torque, slope) in zip(TURNED, (rows @ nominal_parameters(robot)).reshape(3, -1).T, strict=True):
        pin.crba(model_, data, coupling @ pose)
        mass = np.triu(data.M) + np.triu(data.M, 1).T
        assert inertia == pytest.approx((coupling.T @ mass @ coupling)[index, index] + motor)
        for away in (0.0, 0.3):
            moved = pose + away * np.eye(6)[index]
            held = (coupling.T @ pin.computeGeneralizedGravity(model_, data, coupling @ moved))[index]
            assert torque * np.cos(away) + slope * np.sin(away) == pytest.approx(held, abs=1e-6)
    readout = CATALOGUE["parallelogram"].readout
    assert readout is not None
    motion = tracks(robot, joint, swept(joint, TURNED, blocks=FORWARD, repeats=1))
    change = ((rows - load_rows(robot, index, TURNED)) @ nominal_parameters(robot)).reshape(3, -1)
    order = [np.flatnonzero(np.abs(TURNED - pose).max(axis=1) < 1e-3)[0] for pose in motion.poses]
    share = readout(motion, 0.9 * change[:, order], np.zeros((change.size, change.size)))["share_joint_2"]
    assert share[:2] == pytest.approx((0.9, 0.0))


def test_only_parallel_joints_can_have_a_parallelogram() -> None:
    """A pendulum has one joint; the last joint of the arm turns a body that is round about it."""
    assert parallelograms(pendulum(), 0, POSES) == {}
    assert parallelograms(max100(), 5, TURNED) == {}
    assert "parallelogram" not in model().freed
