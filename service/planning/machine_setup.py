"""The machine as configured: drives, robot and cell. A plan of another robot or cell needs a typed confirmation.

The files of robot and cell are those that the settings name; without such a setting, the only ones that fit the joints
of the drive profile. If several fit or none does, the machine has no robot or cell: each is then "another" one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import structlog

from service.model.configuration import read_cell
from service.model.errors import BadInput, Conflict
from service.planning.campaigns.plan_subject import MadeFor
from service.planning.motion_hash import machine_sha256
from service.planning.safety.robot_and_machine import DriveAxis, DriveProfile
from service.process.settings import Settings
from service.store.documents import RobotDocument

_log = structlog.get_logger(__name__)


class NeedsConfirmation(Conflict):
    """A plan of another robot or cell than the machine's: a person has to type their names (API: 409).

    `confirm`: what to type, by "robot" and "cell".
    """

    def __init__(self, reason: str, confirm: Mapping[str, str]) -> None:
        typed = " and ".join(f"{name!r} as confirm_{what}" for what, name in confirm.items())
        super().__init__(f"{reason}. If the machine really has it, type {typed}")
        self.confirm = dict(confirm)


@dataclass(frozen=True)
class MachineSetup:
    """`axes`, `sha256`: of the drive profile. `robot`, `cell`: None if not configured; `missing` says what to set."""

    name: str
    axes: tuple[DriveAxis, ...] = ()
    sha256: str = ""
    robot: RobotDocument | None = None
    cell: str | None = None
    missing: tuple[str, ...] = field(default=())

    def own_cell(self, asked: str | None = None) -> str:
        """The cell `asked` for, else the machine's. Conflict if there is none."""
        if not asked and self.cell is None:
            raise Conflict(f"machine {self.name!r} has no cell: {'; '.join(self.missing)}")
        return asked or self.cell or ""

    def confirmed(self, robot: RobotDocument, cell: str, typed: Mapping[str, str | None], by: str) -> MadeFor:
        """What a plan for this machine stores. NeedsConfirmation if robot or cell is not the machine's and its name
        was not `typed`.
        """
        others = self._others(robot, cell)
        wanting = {what: name for what, name in others.items() if (typed.get(what) or "").strip() != name}
        if wanting:
            raise NeedsConfirmation(self._differs(robot, cell, wanting), wanting)
        return MadeFor(machine=self.name, confirmed=others, by=by if others else "")

    def check(self, robot: RobotDocument, cell: str, made_for: MadeFor | None) -> None:
        """Conflict unless a plan is of the machine's robot and cell, or a person confirmed the others for this
        machine.
        """
        known = made_for.confirmed if made_for is not None and made_for.machine == self.name else {}
        others = {what: name for what, name in self._others(robot, cell).items() if known.get(what) != name}
        if others:
            raise Conflict(f"{self._differs(robot, cell, others)}: make the plan again")

    def _others(self, robot: RobotDocument, cell: str) -> dict[str, str]:
        """Names of what is not the machine's. A changed description is another robot, whatever its name."""
        own = self.robot is not None and _same(self.robot, robot)
        return ({} if own else {"robot": robot.name}) | ({} if self.cell == cell else {"cell": cell})

    def _differs(self, robot: RobotDocument, cell: str, others: Mapping[str, str]) -> str:
        plan, machine = {"robot": named(robot), "cell": cell}, self._own_names()
        parts = [f"{what} {plan[what]}, but machine {self.name!r} has {machine[what]}" for what in others]
        return f"the plan is of {'; and of '.join(parts)}"

    def _own_names(self) -> dict[str, str]:
        unknown = f"none that is known ({'; '.join(self.missing)})"
        return {"robot": named(self.robot) if self.robot else unknown, "cell": self.cell or unknown}


def named(robot: RobotDocument) -> str:
    """Name and number of a robot: descriptions that differ have different numbers."""
    serial = f", serial number {robot.serial}" if robot.serial else ""
    return f"{robot.name} (number {robot.id}{serial})"


def _same(one: RobotDocument, other: RobotDocument) -> bool:
    """Equal but for the name of the URDF file, which is another one in a bundle."""
    renamed = one.description.model_copy(update={"urdf": other.description.urdf})
    return renamed == other.description and one.urdf_text == other.urdf_text


def machine_setup(
    settings: Settings, profile: object, joints: Sequence[str], robots: Mapping[str, RobotDocument]
) -> MachineSetup:
    """The setup by settings and files, also in the log. Blocks. `joints`: of the machine. `robots`: those of
    `robots_dir`, by file name without ending.

    BadInput if a setting names a file that does not exist or, for the cell, cannot be read.
    """
    axes = DriveProfile.model_validate(profile).of(joints)
    missing: list[str] = []
    fitting = sorted(stem for stem, robot in robots.items() if _fits(robot, axes))
    stem = settings.robot
    if stem is None and len(fitting) == 1:
        (stem,) = fitting
    if stem is None:
        missing.append(_choose("robot", settings.robots_dir, fitting))
    elif stem not in robots:
        known = ", ".join(sorted(robots)) or "none"
        raise BadInput("robot", f"there is no robot {stem} in {settings.robots_dir}; there is: {known}")
    robot = None if stem is None else robots[stem]
    cell = settings.cell
    if cell is not None:
        read_cell(settings.cells_dir / f"{cell}.yaml")
    else:
        cells = sorted(path.stem for path in settings.cells_dir.glob("*.yaml") if _has_room_for(path, robot))
        if len(cells) == 1:
            (cell,) = cells
        else:
            missing.append(_choose("cell", settings.cells_dir, cells))
    name, sha256 = settings.machine_name, machine_sha256(profile, settings.drive.parent)
    _log.info("machine_setup", machine=name, robot=None if robot is None else named(robot), cell=cell)
    for reason in missing:
        _log.warning("machine_setup_missing", reason=reason)
    return MachineSetup(name, axes, sha256, robot, cell, tuple(missing))


def _fits(robot: RobotDocument, axes: Sequence[DriveAxis]) -> bool:
    """The joints of the drives are those of the robot, in its order; a robot may have more."""
    joints = [axis.joint for axis in axes]
    return joints == [axis.joint for axis in robot.description.axes if axis.joint in joints]


def _has_room_for(path: Path, robot: RobotDocument | None) -> bool:
    """Whether the rest position of a cell is for joints of this robot. A file that cannot be read may be the cell."""
    try:
        cell = read_cell(path)
    except BadInput:
        return True
    return robot is None or all(joint in {axis.joint for axis in robot.description.axes} for joint in cell.home)


def _choose(what: str, folder: Path, fitting: Sequence[str]) -> str:
    found = f"{', '.join(fitting)} fit" if fitting else "none fits"
    return f"set `{what}` (SWEEPID_{what.upper()}) to the name of a file of {folder}: of these, {found} the machine"
