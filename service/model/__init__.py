"""What the service talks about: robot, recording, geometry, results, configuration.

Most rooms import from here.
"""

from service.model.arrays import Array, Complex, Indices, Mask
from service.model.physical_bounds import Most, Position, Velocity
from service.model.recording import (
    OPTIONAL_COLUMNS,
    REQUIRED_COLUMNS,
    Name,
    Recording,
    Sine,
    Sweep,
    SweepPurpose,
    SweepSpec,
    together,
)
from service.model.robot import (
    INERTIAL_NAMES,
    Axis,
    Knowledge,
    Prior,
    Robot,
    RobotDescription,
    build_robot,
    link_frames,
    robot_from_outside,
    rotation_about,
)
from service.model.urdf import Chain, Joint, inertia_matrix, inertia_vector, joint_end, read_chain, transform_inertial

__all__ = [
    "INERTIAL_NAMES",
    "OPTIONAL_COLUMNS",
    "REQUIRED_COLUMNS",
    "Array",
    "Axis",
    "Chain",
    "Complex",
    "Indices",
    "Joint",
    "Knowledge",
    "Mask",
    "Most",
    "Name",
    "Position",
    "Prior",
    "Recording",
    "Robot",
    "RobotDescription",
    "Sine",
    "Sweep",
    "SweepPurpose",
    "SweepSpec",
    "Velocity",
    "build_robot",
    "inertia_matrix",
    "inertia_vector",
    "joint_end",
    "link_frames",
    "read_chain",
    "robot_from_outside",
    "rotation_about",
    "together",
    "transform_inertial",
]
