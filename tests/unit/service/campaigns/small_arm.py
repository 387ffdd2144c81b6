"""A small arm whose geometry can be checked by hand."""

from service.model import Axis, Robot, RobotDescription, build_robot


def _link(name: str, mass: float) -> str:
    return f"""
  <link name="{name}">
    <inertial><origin xyz="0.5 0 0"/><mass value="{mass}"/>
      <inertia ixx="0.1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0.5 0 0" rpy="0 1.5707963267948966 0"/>
      <geometry><cylinder radius="0.1" length="1.0"/></geometry></collision>
  </link>"""


ARM_URDF = f"""<robot name="arm">
  <link name="base"><collision><origin xyz="0 0 0.5"/><geometry><box size="0.3 0.3 1.0"/></geometry></collision></link>
  {_link("upper", 20.0)}
  {_link("fore", 10.0)}
  <link name="tool"><collision><geometry><sphere radius="0.15"/></geometry></collision></link>
  <joint name="j1" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 1"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="1.6" velocity="1.0" effort="2000"/></joint>
  <joint name="j2" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="1 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-2.9" upper="2.9" velocity="1.0" effort="800"/></joint>
  <joint name="tool_fixed" type="fixed"><parent link="fore"/><child link="tool"/><origin xyz="1 0 0"/></joint>
</robot>"""


def small_arm() -> Robot:
    """Shoulder 1 m up, two links of 1 m turning about y, a ball of 0.15 m at the end."""
    axes = (
        Axis(joint="j1", gear_ratio=100.0, motor_inertia=0.001, rated_effort=1000.0, viscous_friction=50.0),
        Axis(joint="j2", gear_ratio=100.0, motor_inertia=0.001, rated_effort=400.0, viscous_friction=20.0),
    )
    return build_robot(RobotDescription(name="arm", urdf="arm.urdf", axes=axes), ARM_URDF)
