"""Robots nobody has seen: the representative one stretched, made heavier, and geared otherwise."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np
import yaml
from numpy.typing import NDArray

from service.robot import Robot, RobotDescription, build_robot
from service.urdf import Chain
from simulator.scenario import NominalRobot
from tests.numeric.campaign import CONFIG

MARGIN = 0.25  # rad to every joint limit: a sweep needs room
RIPPLES = ((24.0, 48.0), (18.0, 36.0), (12.0, 24.0), (36.0, 72.0))


@dataclass(frozen=True)
class Pair:
    """One robot as the service and as the simulator reads it."""

    robot: Robot
    nominal: NominalRobot


def random_robot(random: np.random.Generator, name: str) -> Pair:
    """Lengths 0.6 to 1.2 of the MAX 100 class, masses 0.4 to 1.3 times those of the same shape."""
    data = yaml.safe_load((CONFIG / "robots/max100-class.yaml").read_text())
    root = ET.fromstring((CONFIG / "robots" / data["urdf"]).read_text())
    length, mass = random.uniform(0.6, 1.2), random.uniform(0.4, 1.3)
    for link in root.findall("link"):
        for shape in link.findall("collision") + link.findall("visual"):
            link.remove(shape)
        factor = mass * random.uniform(0.85, 1.15)
        for element in link.iter("mass"):
            element.set("value", repr(float(element.attrib["value"]) * factor))
        for element in link.iter("inertia"):
            for key, value in element.attrib.items():
                element.set(key, repr(float(value) * factor * length**2))
    for origin in root.iter("origin"):
        origin.set("xyz", " ".join(repr(float(x) * length) for x in origin.attrib["xyz"].split()))
    ripple = RIPPLES[random.integers(len(RIPPLES))]
    for axis in data["axes"]:
        ratio = axis["gear_ratio"] * random.uniform(0.75, 1.25)
        reflected = axis["motor_inertia"] * axis["gear_ratio"] ** 2 * mass * length**2 * random.uniform(0.8, 1.2)
        axis |= {
            "gear_ratio": ratio,
            "motor_inertia": reflected / ratio**2,
            "rated_effort": axis["rated_effort"] * mass * length,
            "viscous_friction": axis["viscous_friction"] * mass * length * random.uniform(0.5, 2.0),
            "cogging_orders": ripple,
        }
    text = ET.tostring(root, encoding="unicode")
    data |= {"name": name, "urdf": "robot.urdf"}
    robot = build_robot(RobotDescription.model_validate(data), text)
    return Pair(robot, NominalRobot.model_validate(data | {"urdf": text}))


def random_poses(random: np.random.Generator, chain: Chain, joint: int, count: int) -> NDArray[np.float64]:
    """Poses (count, n) within the limits: joint number `joint` spread over its range, the wrist at zero."""
    poses = np.zeros((count, len(chain.joints)))
    for k in range(3):
        low, high = max(chain.joints[k].lower, -1.6) + MARGIN, min(chain.joints[k].upper, 1.6) - MARGIN
        share = random.uniform(size=count)
        if k == joint:
            share = (np.arange(count) + 0.2 + 0.6 * share) / count
        poses[:, k] = low + (high - low) * random.permutation(share)
    return poses
