"""A rigid axis whose effort is a formula: an arm in the plane, its second joint a slide that sets the inertia.

The arm's inertia is 4, the slide's mass 2 at 1 + q2 from the axis, the motor 100^2 1e-4 = 1: J = 5 + 2 (1 + q2)^2. CAD
believes in a slide of 1 kg.
"""

import numpy as np

from service.model import Axis, Robot, RobotDescription, Sweep, build_robot
from tests.formula_sweep import Turning, by_formula, lines

URDF = """<robot name="pair">
  <link name="base"/>
  <link name="arm">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="4" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="slide">
    <inertial><mass value="1"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="flange"/>
  <joint name="j1" type="revolute"><parent link="base"/><child link="arm"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="100"/></joint>
  <joint name="j2" type="prismatic"><parent link="arm"/><child link="slide"/><origin xyz="1 0 0"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="1" velocity="1" effort="100"/></joint>
  <joint name="mount" type="fixed"><parent link="slide"/><child link="flange"/><origin xyz="0.5 0 0.7"/></joint>
</robot>
"""
VISCOUS, DRY, NOISE = 4.0, 6.0, 1e-3
SINES = lines((2.0, 3.0, 4.0, 5.0), 0.01)
RATE, OFFSET = 500.0, 0.1


def robot(motor_inertia: float | None = 1e-4) -> Robot:
    axes = (
        Axis(joint="j1", gear_ratio=100.0, motor_inertia=motor_inertia, rated_effort=100.0, viscous_friction=VISCOUS),
        Axis(joint="j2", gear_ratio=600.0, rated_effort=100.0),
    )
    return build_robot(RobotDescription(name="pair", urdf="robot.urdf", axes=axes), URDF)


def true_inertia(slide: float) -> float:
    return 5.0 + 2.0 * (1.0 + slide) ** 2


def sweeps(slides: list[float]) -> tuple[Sweep, ...]:
    """One sweep a position of the slide, in turn."""
    random = np.random.default_rng(0)
    return tuple(_sweep(number, slide, random) for number, slide in enumerate(slides, start=1))


def _sweep(number: int, slide: float, random: np.random.Generator) -> Sweep:
    def effort(m: Turning) -> np.ndarray:
        return true_inertia(slide) * m.acceleration + VISCOUS * m.velocity + DRY + random.normal(0, NOISE, len(m.time))

    told = {"id": f"{number:04}", "axis": "j1", "pose": (0.0, slide), "offset_velocity": OFFSET, "sines": SINES}
    return by_formula(effort, 5.0, **told, periods=5, sample_rate=RATE, started_at=10.0 * number)
