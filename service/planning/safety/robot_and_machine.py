"""Consistency of robot and machine: values that are in the files of the robot and in the drive profile must be equal,
and limits of the profile at most those of the robot. The narrower one is the limit (`on_machine`).

A wrong gear ratio makes every inertia wrong by its square without any error; a plan for another robot moves joints
without a check. Pure: `COMPARED` is the table of compared values.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import cast

from pydantic import BaseModel, ConfigDict, OnErrorOmit, field_validator

from service.model.robot import Robot

MOST_LISTED = 8  # differences in one sentence


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


@dataclass(frozen=True)
class _Side:
    """One axis of both, and its index in the robot."""

    robot: Robot
    index: int
    drive: DriveAxis


Value = float | None


@dataclass(frozen=True)
class Comparison:
    """`robot` and `drive` return a value each, None: nothing to compare; `fits`: whether the two values agree."""

    what: str
    unit: Callable[[str], str]
    robot: Callable[[_Side], Value]
    drive: Callable[[_Side], Value]
    fits: Callable[[float, float], bool]
    narrower: bool = False  # a limit, which the drive may narrow


def _within(relative: float) -> Callable[[float, float], bool]:
    return lambda robot, drive: math.isclose(robot, drive, rel_tol=relative)


def _not_below(tolerance: float) -> Callable[[float, float], bool]:
    return lambda robot, drive: drive >= robot - tolerance


def _not_above(tolerance: float) -> Callable[[float, float], bool]:
    return lambda robot, drive: drive <= robot + tolerance


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


# Gear ratios are quotients of numbers of teeth: a rounded one is within 0.1 %. Rated torques are rounded more.
# The drive may have narrower limits than the robot: plans for it keep them, see `on_machine`.
COMPARED = (
    Comparison(
        "gear ratio",
        lambda _: "",
        lambda s: s.robot.axes[s.index].gear_ratio,
        lambda s: s.drive.gear_ratio,
        _within(1e-3),
    ),
    Comparison("rated effort", _effort, lambda s: s.robot.axes[s.index].rated_effort, _rated_effort, _within(1e-2)),
    Comparison(
        "lower limit",
        str,
        lambda s: s.robot.chain.joints[s.index].lower,
        lambda s: _limit(s, 0),
        _not_below(1e-3),
        True,
    ),
    Comparison(
        "upper limit",
        str,
        lambda s: s.robot.chain.joints[s.index].upper,
        lambda s: _limit(s, 1),
        _not_above(1e-3),
        True,
    ),
    Comparison(
        "velocity limit",
        lambda unit: f"{unit}/s",
        lambda s: s.robot.chain.joints[s.index].velocity,
        lambda s: s.drive.velocity_limit,
        _at_most(1e-3),
        True,
    ),
    Comparison(
        "effort limit",
        _effort,
        lambda s: s.robot.chain.joints[s.index].effort,
        lambda s: s.drive.effort_limit,
        _at_most(1e-2),
        True,
    ),
)


def _unit(side: _Side) -> str:
    return "m" if side.robot.chain.joints[side.index].kind == "prismatic" else "rad"


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


def narrowed(robot: Robot, axes: Sequence[DriveAxis]) -> str:
    """Limits that a drive profile narrows, in one sentence; "" if none."""
    found: list[str] = []
    for axis in axes:
        if axis.joint not in robot.joints:
            continue
        side = _Side(robot, robot.index(axis.joint), axis)
        unit = _unit(side)
        for row in COMPARED:
            ours, theirs = row.robot(side), row.drive(side)
            if (
                row.narrower
                and ours is not None
                and theirs is not None
                and not math.isclose(ours, theirs, rel_tol=1e-3)
            ):
                found.append(f"{axis.joint} {row.what} {theirs:.6g} instead of {ours:.6g} {row.unit(unit)}")
    return "; ".join(found)


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
        side = _Side(robot, robot.index(axis.joint), axis)
        unit = _unit(side)
        if axis.unit not in (None, unit):
            found.append(f"{axis.joint} unit: {robot_place} has {unit}, {drive_place} has {axis.unit}")
            continue
        for row in COMPARED:
            ours, theirs = row.robot(side), row.drive(side)
            if ours is not None and theirs is not None and not row.fits(ours, theirs):
                one, other = (f"{value:.6g} {row.unit(unit)}".rstrip() for value in (ours, theirs))
                found.append(f"{axis.joint} {row.what}: {robot_place} has {one}, {drive_place} has {other}")
    more = [f"and {len(found) - MOST_LISTED} more"] if len(found) > MOST_LISTED else []
    return "; ".join([*found[:MOST_LISTED], *more])
