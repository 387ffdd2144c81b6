"""Do robot and machine belong together? What the robot's files and the drive profile both say must be the same.

A gear ratio that differs turns every inertia wrong by its square without a word; a plan for another robot moves joints
that nobody checked. Pure: `COMPARED` is the table of what is compared.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import cast

from pydantic import BaseModel, ConfigDict, OnErrorOmit, field_validator

from service.robot import Robot

MOST_TOLD = 8  # differences in one sentence


class DriveAxis(BaseModel):
    """What a drive profile says of an axis; None where the adapter's profile does not have it."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)
    joint: str
    unit: str | None = None  # rad or m
    gear_ratio: float | None = None  # as in the robot's side file
    rated_torque: float | None = None  # N m, of the motor
    position_limits: tuple[float, float] | None = None  # rad (m)
    velocity_limit: float | None = None  # rad/s (m/s)
    effort_limit: float | None = None  # N m (N)


class DriveProfile(BaseModel):
    """What a drive profile says of its axes; entries of an adapter with other words are left out."""

    model_config = ConfigDict(frozen=True, extra="ignore")
    axes: tuple[OnErrorOmit[DriveAxis], ...] = ()

    @field_validator("axes", mode="before")
    @classmethod
    def _entries(cls, given: object) -> object:
        return cast("object", given) if isinstance(given, list) else ()

    def of(self, joints: Sequence[str]) -> tuple[DriveAxis, ...]:
        """In the order of a machine's `joints`; of one that has no entry nothing is known but its name."""
        entries = {axis.joint: axis for axis in self.axes}
        return tuple(entries.get(joint, DriveAxis(joint=joint)) for joint in joints)


@dataclass(frozen=True)
class _Side:
    """One axis of both: its number in the robot."""

    robot: Robot
    index: int
    drive: DriveAxis


Value = float | None


@dataclass(frozen=True)
class Comparison:
    """`robot` and `drive` give a value each, None: nothing to compare; `fits` tells of both whether they do."""

    what: str
    unit: Callable[[str], str]
    robot: Callable[[_Side], Value]
    drive: Callable[[_Side], Value]
    fits: Callable[[float, float], bool]


def _within(relative: float) -> Callable[[float, float], bool]:
    return lambda robot, drive: math.isclose(robot, drive, rel_tol=relative)


def _near(tolerance: float) -> Callable[[float, float], bool]:
    return lambda robot, drive: math.isinf(robot) or abs(robot - drive) <= tolerance


def _at_most(relative: float) -> Callable[[float, float], bool]:
    return lambda robot, drive: drive <= robot * (1 + relative)


def _rated_effort(side: _Side) -> float | None:
    drive = side.drive
    if drive.rated_torque is None or drive.gear_ratio is None:
        return None
    return drive.rated_torque * abs(drive.gear_ratio)


def _limit(side: _Side, end: int) -> float | None:
    return None if side.drive.position_limits is None else side.drive.position_limits[end]


def _effort(unit: str) -> str:
    return "N" if unit == "m" else "N m"


# Gear ratios are whole numbers of teeth over another: a rounded one is within 0.1 %. Rated torques are rounded more.
# Limits of position are the same, or the plan goes where the drive refuses, or the drive where the robot ends. What a
# drive may give less than the robot bears, it may.
COMPARED = (
    Comparison(
        "gear ratio",
        lambda _: "",
        lambda s: s.robot.axes[s.index].gear_ratio,
        lambda s: s.drive.gear_ratio,
        _within(1e-3),
    ),
    Comparison("rated effort", _effort, lambda s: s.robot.axes[s.index].rated_effort, _rated_effort, _within(1e-2)),
    Comparison("lower limit", str, lambda s: s.robot.chain.joints[s.index].lower, lambda s: _limit(s, 0), _near(1e-3)),
    Comparison("upper limit", str, lambda s: s.robot.chain.joints[s.index].upper, lambda s: _limit(s, 1), _near(1e-3)),
    Comparison(
        "velocity limit",
        lambda unit: f"{unit}/s",
        lambda s: s.robot.chain.joints[s.index].velocity,
        lambda s: s.drive.velocity_limit,
        _at_most(1e-3),
    ),
    Comparison(
        "effort limit",
        _effort,
        lambda s: s.robot.chain.joints[s.index].effort,
        lambda s: s.drive.effort_limit,
        _at_most(1e-2),
    ),
)


def differences(
    robot: Robot, robot_place: str, axes: Sequence[DriveAxis], drive_place: str, moved: Collection[str] = ()
) -> str:
    """Where robot and machine differ, with both places and both values, in one sentence; "" if they fit.

    The machine's joints are the robot's, in the same order; joints that are not to be `moved` may have no drive.
    """
    joints = [axis.joint for axis in axes]
    alike = joints == [joint for joint in robot.joints if joint in joints]
    if not alike or any(joint in robot.joints and joint not in joints for joint in moved):
        return f"joints: {robot_place} has {', '.join(robot.joints)}; {drive_place} has {', '.join(joints)}"
    told: list[str] = []
    for axis in axes:
        index = robot.index(axis.joint)
        side = _Side(robot, index, axis)
        unit = "m" if robot.chain.joints[index].kind == "prismatic" else "rad"
        if axis.unit not in (None, unit):
            told.append(f"{axis.joint} unit: {robot_place} has {unit}, {drive_place} has {axis.unit}")
            continue
        for row in COMPARED:
            ours, theirs = row.robot(side), row.drive(side)
            if ours is not None and theirs is not None and not row.fits(ours, theirs):
                one, other = (f"{value:.6g} {row.unit(unit)}".rstrip() for value in (ours, theirs))
                told.append(f"{axis.joint} {row.what}: {robot_place} has {one}, {drive_place} has {other}")
    more = [f"and {len(told) - MOST_TOLD} more"] if len(told) > MOST_TOLD else []
    return "; ".join([*told[:MOST_TOLD], *more])
