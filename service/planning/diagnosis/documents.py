"""Request and plan of a campaign for a diagnosis, and of a single experiment."""

from collections.abc import Iterable
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from drivers.ports import SweepMode
from service.identification.design.diagnosis_sweeps import BLOCKS, FAST, SLOW, WIDE, WIDE_LINES
from service.identification.estimates.torque_gain import KnownMass
from service.model.errors import BadInput
from service.model.robot import Robot
from service.planning.campaigns.plan_subject import MadeFor
from service.planning.documents import (
    CELL_NAME,
    MOVE_VELOCITY,
    SAMPLE_RATE,
    DroppedPose,
    PlannedSweep,
    PlanRequest,
)
from service.planning.safety.envelope import Limits
from service.store.documents import LARGEST_ID, BoltedMass

TRAVEL_MARGIN = 1.05  # of a block's travel: the sines oscillate around the offset motion
PEAK_VELOCITY = 0.15  # rad/s (m/s), instantaneous: the fast blocks are three times as fast as other sweeps


class DiagnosisRequest(BaseModel):
    """What to measure for a diagnosis; `varied`, `step` and `cell` as in a plan of sweeps. `poses`: for each axis."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    kind: Literal["diagnosis"]
    robot_id: int = Field(ge=1, le=LARGEST_ID)
    cell: str = Field(default="", pattern=CELL_NAME)
    axes: tuple[str, ...] = Field(min_length=1)
    varied: tuple[str, ...] = Field(min_length=1)
    step: float = Field(default=10.0, ge=0.5, le=90.0)  # deg (prismatic: cm)
    poses: int = Field(default=4, ge=1, le=100)
    blocks: tuple[str, ...] = Field(default=BLOCKS, min_length=1)
    repeats: int = Field(default=2, ge=1, le=10)  # of each block, back to back
    modes: Literal["drive_side", "host_streamed"] = "drive_side"
    sample_rate: float = Field(default=SAMPLE_RATE, ge=10 * max(WIDE_LINES), le=20_000)  # Hz
    move_velocity: float = Field(default=MOVE_VELOCITY, ge=1e-5, le=100.0)  # rad/s (m/s)

    @property
    def mode(self) -> SweepMode:
        return SweepMode(self.modes)

    def as_sweeps(self) -> PlanRequest:
        """The plan of sweeps with the same axes and grid."""
        return PlanRequest(
            robot_id=self.robot_id, cell=self.cell, axes=self.axes, varied=self.varied, step=self.step, poses=1
        )

    def check(self, robot: Robot) -> None:
        """Check against the robot, and for consistency. BadInput names the field."""
        self.as_sweeps().check(robot)
        for block in self.blocks:
            if block not in BLOCKS:
                raise BadInput("blocks", f"unknown block {block}; there are {', '.join(BLOCKS)}")
        if len(set(self.blocks)) < len(self.blocks):
            raise BadInput("blocks", f"names a block twice: {', '.join(self.blocks)}")


class ExperimentRequest(BaseModel):
    """An experiment with designed sweeps, and the test mass that is mounted; the other fields as in a plan of
    sweeps.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    kind: Literal["experiment"] = "experiment"
    robot_id: int = Field(ge=1, le=LARGEST_ID)
    cell: str = Field(default="", pattern=CELL_NAME)
    modes: Literal["drive_side", "host_streamed"] = "drive_side"
    move_velocity: float = Field(default=MOVE_VELOCITY, ge=1e-5, le=100.0)  # rad/s (m/s)
    test_mass: BoltedMass | None = None

    @property
    def mode(self) -> SweepMode:
        return SweepMode(self.modes)

    @property
    def known_mass(self) -> KnownMass | None:
        """The test mass as a rigid body."""
        return None if self.test_mass is None else KnownMass(**self.test_mass.model_dump())


class _DesignedPlan(BaseModel):
    """Designed sweeps in the order of execution."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    robot: str
    sweeps: tuple[PlannedSweep, ...]
    dropped: tuple[DroppedPose, ...]  # the reason names the omitted blocks of the pose
    duration: float  # s
    made_for: MadeFor | None = None  # as in a plan of sweeps

    @property
    def limits(self) -> Limits:
        """Limits of these sweeps."""
        return limits(sweep.spec.block for sweep in self.sweeps)


class DiagnosisPlan(_DesignedPlan):
    """The complete campaign of a diagnosis."""

    request: DiagnosisRequest
    candidates: int  # poses of the grid
    measurable: int  # collision-free


class ExperimentPlan(_DesignedPlan):
    """The sweeps that a diagnosis requests."""

    request: ExperimentRequest


def limits(blocks: Iterable[str]) -> Limits:
    """Limits for sweeps of these blocks: as usual, except for the travel and speed of wide and fast blocks."""
    widest = max(FAST if block.endswith("fast") else WIDE if block.endswith("wide") else 1.0 for block in blocks)
    return Limits(travel=TRAVEL_MARGIN * widest * SLOW, sweep_velocity=PEAK_VELOCITY)
