"""The cell around a robot: obstacles, clearance, and rest position of the robot.

Read from `config/cells/NAME.yaml`. Lengths in m, angles in rad, in the base frame of the robot.
"""

from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from service.model.configuration import read_yaml
from service.model.errors import BadInput


class Box(BaseModel):
    """A box obstacle: `size` are the full edge lengths, m; `yaw` turns it about the vertical, rad."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    name: str = Field(min_length=1)
    center: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw: float = 0.0


class Cell(BaseModel):
    """The obstacles and distances for a robot.

    `clearance`: smallest distance between the robot and any obstacle, or between its own links, m.
    `joint_margin`: distance kept from every joint limit, rad (m).
    `ignored_pairs`: pairs of links that are close by construction (neighbours are always ignored).
    `home`: rest position by joint, rad (m); 0 for joints not listed.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    name: str = Field(min_length=1)
    clearance: float = Field(default=0.03, gt=0)
    joint_margin: float = Field(default=0.02, ge=0)
    floor: float | None = None  # height of the floor, m; None: there is none
    boxes: tuple[Box, ...] = ()
    ignored_pairs: tuple[tuple[str, str], ...] = ()
    home: dict[str, float] = {}

    def home_pose(self, joints: tuple[str, ...]) -> tuple[float, ...]:
        """The rest position for a robot's joints; BadInput for a joint the robot does not have."""
        for joint in self.home:
            if joint not in joints:
                raise BadInput(f"cell {self.name} home", f"unknown joint {joint}; the robot has {', '.join(joints)}")
        return tuple(self.home.get(joint, 0.0) for joint in joints)


def read_cell(path: Path) -> Cell:
    """A cell from its YAML file; BadInput names the field, or the existing cells."""
    if not path.exists():
        known = ", ".join(sorted(other.stem for other in path.parent.glob("*.yaml"))) or "none"
        raise BadInput("cell", f"there is no cell {path.stem} in {path.parent}; there is: {known}")
    return read_yaml(path, Cell)
