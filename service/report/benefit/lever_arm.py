"""Distance of the end of the robot from an axis."""

import xml.etree.ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from service.model.robot import Robot, link_frames
from service.model.urdf import read_origin

Array = NDArray[np.float64]

ON_THE_AXIS = 0.01  # m: if nearer, a force at the end has no torque about the axis


def end_of(robot: Robot) -> Array:
    """Origin (3,) of the last link in the frame of the last moving one, along fixed joints to their end, for example a
    flange or tool.
    """
    root = ET.fromstring(robot.urdf_text)  # the robot's chain was read from it: it is valid
    fixed = {
        parent.get("link"): (joint, child.get("link"))
        for joint in root.findall("joint")
        if joint.get("type") == "fixed"
        and (parent := joint.find("parent")) is not None
        and (child := joint.find("child")) is not None
    }
    link: str | None = robot.chain.joints[-1].link
    rotation, place = np.eye(3), np.zeros(3)
    while link in fixed:
        joint, link = fixed[link]
        turn, way = read_origin(joint, f"joint {joint.get('name')}")
        place = place + rotation @ way
        rotation = rotation @ turn
    return place


def lever_arm(robot: Robot, own: int, poses: Array) -> Array:
    """Distance (m,) in m between the robot's end and the line of revolute joint number `own`, at poses (m, joints)."""
    rotations, origins = link_frames(robot.chain, poses)
    end = origins[:, -1] + rotations[:, -1] @ end_of(robot)
    axis = rotations[:, own] @ robot.chain.joints[own].axis
    return np.linalg.norm(np.cross(axis, end - origins[:, own]), axis=-1)
