"""Metadata of all formats: units and meaning of the columns, robot and sweeps."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

from pydantic import BaseModel, ConfigDict

from service.model.recording import Sweep, SweepSpec
from service.model.robot import Robot, RobotDescription

FORMAT = "sweepid-recordings/1"
DOCUMENT, URDF = "recordings.json", "robot.urdf"
UNKNOWN = datetime.fromtimestamp(0, UTC)  # for an unknown start of the campaign: a bundle does not contain it

MEANINGS: Mapping[str, str] = {
    "time": "the drive's own clock, from the beginning of the sweep on",
    "effort": "drive torque (force) from the torque-forming current, on the joint side",
    "velocity": "motor encoder, on the joint side",
    "position": "motor encoder, on the joint side",
    "velocity_setpoint": "commanded, on the joint side",
    "excitation_effort": "injected torque (force), on the joint side",
    "load_velocity": "direct encoder on the joint",
    "load_position": "direct encoder on the joint",
    "temperature": "of the drive train",
}
_TURNING = {"effort": "N m", "velocity": "rad/s", "position": "rad"}
_SLIDING = {"effort": "N", "velocity": "m/s", "position": "m"}
_LIKE = {
    "velocity_setpoint": "velocity",
    "excitation_effort": "effort",
    "load_velocity": "velocity",
    "load_position": "position",
}


@dataclass(frozen=True, slots=True)
class Recordings:
    """The data to write: sweeps of a robot, and the start of their campaign (`started_at` is relative to it)."""

    robot: Robot
    sweeps: Sequence[Sweep]
    began: datetime


class _Document(BaseModel):
    model_config = ConfigDict(frozen=True)
    format: Literal["sweepid-recordings/1"]
    robot: RobotDescription
    sweeps: tuple[SweepSpec, ...]


def slides(robot: Robot, joint: str) -> bool:
    return robot.chain.joints[robot.index(joint)].kind == "prismatic"


def unit_of(column: str, prismatic: bool) -> str:
    """SI unit, in a notation that UDUNITS and Pint also read."""
    match column:
        case "time":
            return "s"
        case "temperature":
            return "degC"
        case _:
            return (_SLIDING if prismatic else _TURNING)[_LIKE.get(column, column)]


def document(recordings: Recordings) -> str:
    """Robot and sweeps as JSON in the format of bundle.json, without samples."""
    description = recordings.robot.description.model_copy(update={"urdf": URDF})
    specs = tuple(sweep.spec for sweep in recordings.sweeps)
    return _Document(format=FORMAT, robot=description, sweeps=specs).model_dump_json(indent=1)
