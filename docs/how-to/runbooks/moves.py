"""The motion of a plan for each axis, from the API's documents of plan and robot."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby, product
from typing import Any

import numpy as np

from service.formats.export.sheets.inertias import Inertias
from service.model import Robot, RobotDescription, build_robot
from service.report.benefit.benefit import ON_THE_AXIS, lever_arm

Json = Mapping[str, Any]


@dataclass(frozen=True)
class Move:
    """Largest motion of an axis: rad (m); at the arm's end in mm; duration of its sweeps, s.

    `arm_mm` is None for a linear axis, and for an axis through the arm's end.
    """

    joint: str
    lowest: float
    highest: float
    unit: str  # for display: deg or mm
    arm_mm: float | None
    seconds: float

    def range_shown(self) -> tuple[float, float]:
        """The range in `unit`."""
        if self.unit == "deg":
            return float(np.degrees(self.lowest)), float(np.degrees(self.highest))
        return 1e3 * self.lowest, 1e3 * self.highest

    def document(self) -> dict[str, Any]:
        low, high = self.range_shown()
        return asdict(self) | {f"lowest_{self.unit}": low, f"highest_{self.unit}": high}


def robot_of(document: Json) -> Robot:
    """The robot from the document of the service."""
    return build_robot(RobotDescription.model_validate(document["description"]), document["urdf_text"])


def moves(robot: Robot, sweeps: Sequence[Json], stands: Mapping[str, float | None]) -> list[Move]:
    """Motion of the sweeps in a plan's document, from the present joint positions (None: not known). Axes without
    motion are left out.

    The range of a sweep is its position window, which the sweep never leaves.
    """
    places: dict[str, list[float]] = {joint: [] for joint in robot.joints}
    seconds = dict.fromkeys(robot.joints, 0.0)
    poses: list[list[float]] = []
    for _, together in groupby(sweeps, lambda sweep: sweep["spec"]["started_at"]):
        group = {sweep["spec"]["axis"]: sweep for sweep in together}
        first = next(iter(group.values()))  # has the legs and the time of all
        pose = dict(zip(robot.joints, first["spec"]["pose"], strict=True))
        for axis, sweep in group.items():
            seconds[axis] += first["duration"]
            places[axis] += sweep["position_window"]
        for leg in first["legs"]:
            places[leg["joint"]].append(leg["target"])
        for joint, position in pose.items():
            places[joint].append(position)
        # an axis that moves alone does not change its own arm
        ends = product(*(sweep["position_window"] for sweep in group.values())) if len(group) > 1 else [()]
        poses += [list((pose | dict(zip(group, corner, strict=False))).values()) for corner in ends]
    for joint, position in stands.items():
        if position is not None and joint in places:
            places[joint].append(position)
    arms = [float(lever_arm(robot, number, np.array(poses)).max()) for number in range(len(robot.joints))]
    found: list[Move] = []
    for joint, kind, arm in zip(robot.joints, (one.kind for one in robot.chain.joints), arms, strict=True):
        lowest, highest = min(places[joint], default=0.0), max(places[joint], default=0.0)
        if highest - lowest < Inertias.still:
            continue
        linear = kind == "prismatic"
        way = None if linear or arm < ON_THE_AXIS else 1e3 * arm * (highest - lowest)
        found.append(Move(joint, lowest, highest, "mm" if linear else "deg", way, seconds[joint]))
    return found
