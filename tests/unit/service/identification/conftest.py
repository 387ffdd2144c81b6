"""A two-axis robot small enough to reason about, as the identification sees it."""

import pytest

from service.model import Axis, Prior, Robot, RobotDescription, build_robot

URDF = """<robot name="pair"><link name="base"/>
<link name="column"><inertial><origin xyz="0 0 0.3"/><mass value="200"/>
<inertia ixx="20" iyy="20" izz="15" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="arm"><inertial><origin xyz="1.2 0 0"/><mass value="150"/>
<inertia ixx="3" iyy="40" izz="40" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="swing" type="revolute"><parent link="base"/><child link="column"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" velocity="2" effort="5000"/></joint>
<joint name="lift" type="revolute"><parent link="column"/><child link="arm"/><origin xyz="0.3 0 0.8"/>
<axis xyz="0 -1 0"/><limit lower="-1.4" upper="1.4" velocity="2" effort="5000"/></joint></robot>"""


@pytest.fixture
def robot() -> Robot:
    axes = tuple(
        Axis(
            joint=joint,
            gear_ratio=170.0,
            motor_inertia=0.002,
            rated_effort=3000.0,
            viscous_friction=200.0,
            cogging_orders=(24, 48),
        )
        for joint in ("swing", "lift")
    )
    return build_robot(RobotDescription(name="pair", urdf="robot.urdf", axes=axes, prior=Prior()), URDF)
