"""The machine as configured: drives, robot and cell. A plan of another robot or cell needs a typed confirmation.

The files of robot and cell are those that the settings name; without such a setting, the only ones that fit the joints
of the drive profile. If several fit or none does, the machine has no robot or cell: each is then "another" one.

Values that are in the files of the robot and in the drive profile must be equal, and limits of the profile at most
those of the robot; the narrower one is the limit (`on_machine`).
"""

import hashlib
import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import structlog
from pydantic import BaseModel, ConfigDict, OnErrorOmit, field_validator

from service import BadInput, Conflict
from service.model import Robot
from service.model.configuration import read_cell
from service.planning.campaigns.stored_plan import MadeFor
from service.process.settings import Settings
from service.store.documents import RobotDocument


class DriveAxis(BaseModel):
    """Values of an axis in a drive profile; None if the profile of the adapter does not have them."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)
    joint: str
    unit: str | None = None  # rad or m
    gear_ratio: float | None = None  # as in the robot's side file
    rated_torque: float | None = None  # N m, of the motor
    position_limits: tuple[float, float] | None = None  # rad (m)
    velocity_limit: float | None = None  # rad/s (m/s)
    effort_limit: float | None = None  # N m (N)


class DriveProfile(BaseModel):
    """Axes in a drive profile; entries of an adapter with other keys are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore")
    axes: tuple[OnErrorOmit[DriveAxis], ...] = ()

    @field_validator("axes", mode="before")
    @classmethod
    def _entries(cls, given: object) -> object:
        return cast("object", given) if isinstance(given, list) else ()

    def of(self, joints: Sequence[str]) -> tuple[DriveAxis, ...]:
        """In the order of a machine's `joints`; a joint without entry has only its name."""
        entries = {axis.joint: axis for axis in self.axes}
        return tuple(entries.get(joint, DriveAxis(joint=joint)) for joint in joints)


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


def machine_sha256(profile: object, base: Path) -> str:
    """SHA-256 of a drive profile and of each file that it names (EDS, device map, registers), below `base`."""
    named = [text for text in _texts(profile) if _file(base, text)]
    return sha256_of(profile, [hashlib.sha256((base / text).read_bytes()).hexdigest() for text in named])


def _texts(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list | tuple):
        parts = cast("Iterable[object]", value.values() if isinstance(value, Mapping) else value)
        for part in parts:
            yield from _texts(part)


def _file(base: Path, text: str) -> bool:
    try:
        return (base / text).is_file()
    except (OSError, ValueError):  # the text is too long for a name, or contains a zero byte
        return False


def sha256_of(*content: object) -> str:
    """SHA-256 in the order of the content: keys of a profile may be of several types, which cannot be sorted."""
    return hashlib.sha256(json.dumps(content, default=str).encode()).hexdigest()


_log = structlog.get_logger(__name__)


def differences(
    robot: Robot, robot_place: str, axes: Sequence[DriveAxis], drive_place: str, moved: Collection[str] = ()
) -> str:
    """Differences of robot and machine, with both places and both values, in one sentence; "" if they agree.

    The machine's joints are the robot's, in the same order; joints that are not in `moved` may have no drive.
    """
    joints = [axis.joint for axis in axes]
    alike = joints == [joint for joint in robot.joints if joint in joints]
    if not alike or any(joint in robot.joints and joint not in joints for joint in moved):
        return f"joints: {robot_place} has {', '.join(robot.joints)}; {drive_place} has {', '.join(joints)}"
    found: list[str] = []
    for axis in axes:
        unit = _unit(robot, axis.joint)
        if axis.unit not in (None, unit):
            found.append(f"{axis.joint} unit: {robot_place} has {unit}, {drive_place} has {axis.unit}")
            continue
        for pair in _compared(robot, axis):
            if not pair.agree:
                one, other = (f"{value:.6g} {pair.unit}".rstrip() for value in (pair.robot, pair.drive))
                found.append(f"{axis.joint} {pair.what}: {robot_place} has {one}, {drive_place} has {other}")
    listed = 8
    more = [f"and {len(found) - listed} more"] if len(found) > listed else []
    return "; ".join([*found[:listed], *more])


def narrowed(robot: Robot, axes: Sequence[DriveAxis]) -> str:
    """Limits that a drive profile narrows, in one sentence; "" if none."""
    return "; ".join(
        f"{axis.joint} {pair.what} {pair.drive:.6g} instead of {pair.robot:.6g} {pair.unit}"
        for axis in axes
        if axis.joint in robot.joints
        for pair in _compared(robot, axis)
        if pair.is_limit and not math.isclose(pair.robot, pair.drive, rel_tol=1e-3)
    )


def on_machine(robot: Robot, axes: Sequence[DriveAxis]) -> Robot:
    """The robot with those limits of the drives that are narrower than its own.

    A drive refuses a sweep with wider limits.
    """
    root, drives = ET.fromstring(robot.urdf_text), {axis.joint: axis for axis in axes if axis.joint in robot.joints}
    for joint in root.iter("joint"):
        limit, drive = joint.find("limit"), drives.get(joint.get("name", ""))
        if limit is None or drive is None:
            continue
        own, (low, high) = robot.chain.joints[robot.index(drive.joint)], drive.position_limits or (None, None)
        if low is not None and low > own.lower:
            limit.set("lower", repr(low))
        for name, value, ours in (
            ("upper", high, own.upper),
            ("velocity", drive.velocity_limit, own.velocity),
            ("effort", drive.effort_limit, own.effort),
        ):
            if value is not None and value < ours:
                limit.set(name, repr(value))
    return replace(robot, urdf_text=ET.tostring(root, encoding="unicode"))


@dataclass(frozen=True)
class _Pair:
    """One value of an axis in the files of the robot and in the drive profile. `is_limit`: the drive may narrow it."""

    what: str
    unit: str
    robot: float
    drive: float
    agree: bool
    is_limit: bool = False


def _compared(robot: Robot, drive: DriveAxis) -> Iterator[_Pair]:
    """The values that both have. A wrong gear ratio makes every inertia wrong by its square without any error.

    Gear ratios are quotients of numbers of teeth: a rounded one is within 0.1 %. Rated torques are rounded more. The
    drive may have narrower limits than the robot: plans for it keep them, see `on_machine`.
    """
    index = robot.index(drive.joint)
    axis, joint, unit = robot.axes[index], robot.chain.joints[index], _unit(robot, drive.joint)
    effort = "N" if unit == "m" else "N m"
    if drive.gear_ratio is not None:
        agree = math.isclose(axis.gear_ratio, drive.gear_ratio, rel_tol=1e-3)
        yield _Pair("gear ratio", "", axis.gear_ratio, drive.gear_ratio, agree)
    if drive.rated_torque is not None and drive.gear_ratio is not None:
        rated = drive.rated_torque * abs(drive.gear_ratio)
        yield _Pair(
            "rated effort", effort, axis.rated_effort, rated, math.isclose(axis.rated_effort, rated, rel_tol=1e-2)
        )
    if drive.position_limits is not None:
        low, high = drive.position_limits
        yield _Pair("lower limit", unit, joint.lower, low, low >= joint.lower - 1e-3, is_limit=True)
        yield _Pair("upper limit", unit, joint.upper, high, high <= joint.upper + 1e-3, is_limit=True)
    if (fastest := drive.velocity_limit) is not None:
        agree = fastest <= joint.velocity * (1 + 1e-3)
        yield _Pair("velocity limit", f"{unit}/s", joint.velocity, fastest, agree, is_limit=True)
    if (most := drive.effort_limit) is not None:
        yield _Pair("effort limit", effort, joint.effort, most, most <= joint.effort * (1 + 1e-2), is_limit=True)


def _unit(robot: Robot, joint: str) -> str:
    return "m" if robot.chain.joints[robot.index(joint)].kind == "prismatic" else "rad"
