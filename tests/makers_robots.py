"""Robots as their makers describe them, out of the package `example-robot-data`: URDFs with meshes, none ours."""

from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path

import yaml

from service.formats.maker_urdf import UrdfCheck, bare_robot, cell_text, check_urdf, side_file_text
from service.formats.maker_urdf.packages import Packages
from service.model import Robot, RobotDescription, build_robot
from service.model.configuration import Cell, read_text


@dataclass(frozen=True)
class Maker:
    """One of them: the URDF below `robots`, the tip of the chain, what it has, and what of it is measured."""

    name: str
    urdf: str
    tip: str | None
    meshes: str  # kind of the files
    axes: tuple[str, str, str]

    @property
    def varied(self) -> tuple[str, str]:
        return self.axes[1:]


def _joints(pattern: str, *numbers: int) -> tuple[str, str, str]:
    one, two, three = (pattern.format(number) for number in numbers)
    return one, two, three


UR = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
ALEX = ("LeftShoulderPitch", "LeftShoulderRoll", "LeftElbowPitch")

MAKERS = (
    Maker("ur5", "ur_description/urdf/ur5_robot.urdf", None, "stl", UR),
    Maker("ur10", "ur_description/urdf/ur10_robot.urdf", None, "stl", UR),
    # fingers, one of which mimics the other
    Maker("panda", "panda_description/urdf/panda.urdf", "panda_hand", "stl", _joints("panda_joint{}", 1, 2, 4)),
    Maker("xarm7", "xarm_description/urdf/xarm7.urdf", None, "stl", _joints("joint{}", 1, 2, 4)),
    # continuous joints
    Maker("kinova", "kinova_description/robots/kinova.urdf", None, "dae", _joints("j2s6s200_joint_{}", 1, 2, 3)),
    Maker("z1", "z1_description/urdf/z1.urdf", "gripperStator", "stl", _joints("joint{}", 1, 2, 3)),
    # wheels, a head, a lift
    Maker(
        "tiago", "tiago_description/robots/tiago_no_hand.urdf", "arm_7_link", "dae", _joints("arm_{}_joint", 1, 2, 4)
    ),
    # one arm of a humanoid
    Maker("alex", "alex_description/urdf/alex_nub_hands.urdf", "LeftWristRollLink", "obj", ALEX),
)


def share() -> Path:
    """The folder that holds the package."""
    files = distribution("example-robot-data").files or []
    urdf = next(file for file in files if file.name == "ur5_robot.urdf")
    return Path(str(urdf.locate())).resolve().parents[4]


def told_of(maker: Maker) -> UrdfCheck:
    """What `sweepid robot check` makes of it."""
    path = share() / "example-robot-data" / "robots" / maker.urdf
    return check_urdf(read_text(path), Packages([share()], path.parent), maker.tip, maker.name)


def completed(maker: Maker) -> tuple[Robot, Cell]:
    """Its drafts, with gear ratio, motor inertia and rated effort of a plausible drive train put in."""
    told = told_of(maker)
    side = yaml.safe_load(side_file_text(told, maker.name, f"{maker.name}.urdf"))
    for axis, joint in zip(side["axes"], told.chain.joints, strict=True):
        axis["gear_ratio"] = 101.0
        axis["rated_effort"] = 0.5 * joint.effort
        axis["motor_inertia"] = 2e-6 * joint.effort / 10
    description = RobotDescription.model_validate(side)
    cell = Cell.model_validate(yaml.safe_load(cell_text(bare_robot(told), maker.name)[0]))
    return build_robot(description, told.urdf_text), cell
