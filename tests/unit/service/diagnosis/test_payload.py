"""What is read out of a load that changed: a point mass on the flange gives back its mass."""

import numpy as np
import pytest

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.rows.rigid import load_rows, nominal_load
from service.diagnosis.rows.signals import tracks
from service.identification.estimates.torque_gain import KnownMass
from tests.numeric.campaign import max100
from tests.unit.service.diagnosis.following import FORWARD, carrying, swept

POSES = np.array(
    [
        [0.0, -0.8, 0.3, 0.0, 0.4, 0.0],
        [0.0, 0.1, -0.5, 1.2, 0.7, 0.0],
        [0.0, 0.9, 0.9, -1.2, -0.7, 1.0],
        [0.0, 0.4, 0.0, 0.0, 1.2, 0.0],
    ]
)


def test_a_point_mass_on_the_flange_gives_its_mass_and_moments() -> None:
    robot, mass = max100(), KnownMass(40.0, (0.2, 0.0, 0.1))
    motion = tracks(robot, "joint_2", swept("joint_2", POSES, robot=robot, blocks=FORWARD, repeats=1))
    change = carrying(mass)(motion)
    readout = CATALOGUE["payload"].readout
    assert readout is not None
    told = readout(motion, change, np.eye(change.size) * 25.0)
    value, std, unit = told["mass"]
    assert unit == "kg"
    assert abs(value - mass.mass) < 3 * std
    assert value == pytest.approx(mass.mass, rel=0.1)
    # what mass and moments say pulls as the change does
    parameters = np.zeros(11 * len(robot.joints))
    links = robot.chain.inertial.size
    parameters[links - 10 : links - 6] = [told[name][0] for name in ("mass", "moment_x", "moment_y", "moment_z")]
    again = (load_rows(robot, robot.index("joint_2"), motion.poses) @ parameters).reshape(3, -1)
    np.testing.assert_allclose(again[1:], change[1:], atol=0.02 * np.abs(change[1:]).max())


def test_all_of_the_load_once_more_by_a_part_is_a_gain() -> None:
    robot = max100()
    motion = tracks(robot, "joint_2", swept("joint_2", POSES, blocks=FORWARD, repeats=1))
    readout = CATALOGUE["torque_constant_error"].readout
    assert readout is not None
    change = 0.07 * nominal_load(robot, "joint_2", motion.poses)
    assert readout(motion, change, np.zeros((change.size, change.size)))["gain_error"][:2] == pytest.approx((0.07, 0.0))
