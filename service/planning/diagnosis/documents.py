"""What a campaign of a diagnosis is asked for, its plan, and that of a single experiment."""

from collections.abc import Iterable
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from drivers.ports import SweepMode
from service.diagnosis.sensitivity.design import BLOCKS, FAST, SLOW, WIDE, WIDE_LINES
from service.errors import BadInput
from service.identification.estimates.torque_gain import KnownMass
from service.planning.documents import DroppedPose, PlannedSweep, PlanRequest
from service.robot import Robot
from service.safety.envelope import Limits
from service.store.diagnosis_documents import BoltedMass
from service.store.documents import LARGEST_ID

SWAY = 1.05  # of a block's travel: the sines sway on both sides of it
PEAK = 0.15  # rad/s (m/s), at any instant: the fast blocks are three times as fast as other sweeps

CELL_NAME = r"^[A-Za-z0-9][A-Za-z0-9_-]*$"


class DiagnosisRequest(BaseModel):
    """What to measure for a diagnosis; `varied`, `step` and `cell` as in a plan of sweeps. `poses` of each axis."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    kind: Literal["diagnosis"]
    robot_id: int = Field(ge=1, le=LARGEST_ID)
    cell: str = Field(default="workshop", pattern=CELL_NAME)
    axes: tuple[str, ...] = Field(min_length=1)
    varied: tuple[str, ...] = Field(min_length=1)
    step: float = Field(default=10.0, ge=0.5, le=90.0)  # deg (prismatic: cm)
    poses: int = Field(default=4, ge=1, le=100)
    blocks: tuple[str, ...] = Field(default=BLOCKS, min_length=1)
    repeats: int = Field(default=2, ge=1, le=10)  # of each block, back to back
    modes: Literal["drive_side", "host_streamed"] = "drive_side"
    sample_rate: float = Field(default=250.0, ge=10 * max(WIDE_LINES), le=20_000)  # Hz
    move_velocity: float = Field(default=0.1, ge=1e-5, le=100.0)  # rad/s (m/s)

    @property
    def mode(self) -> SweepMode:
        return SweepMode(self.modes)

    def as_sweeps(self) -> PlanRequest:
        """The plan of sweeps with the same axes and grid."""
        return PlanRequest(
            robot_id=self.robot_id, cell=self.cell, axes=self.axes, varied=self.varied, step=self.step, poses=1
        )

    def check(self, robot: Robot) -> None:
        """Does it fit this robot, and itself? BadInput names the field."""
        self.as_sweeps().check(robot)
        for block in self.blocks:
            if block not in BLOCKS:
                raise BadInput("blocks", f"unknown block {block}; there are {', '.join(BLOCKS)}")
        if len(set(self.blocks)) < len(self.blocks):
            raise BadInput("blocks", f"names a block twice: {', '.join(self.blocks)}")


class ExperimentRequest(BaseModel):
    """Of an experiment whose sweeps are designed already, with the mass that is bolted on; the rest as in a plan of
    sweeps.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    kind: Literal["experiment"] = "experiment"
    robot_id: int = Field(ge=1, le=LARGEST_ID)
    cell: str = Field(default="workshop", pattern=CELL_NAME)
    modes: Literal["drive_side", "host_streamed"] = "drive_side"
    move_velocity: float = Field(default=0.1, ge=1e-5, le=100.0)  # rad/s (m/s)
    test_mass: BoltedMass | None = None

    @property
    def mode(self) -> SweepMode:
        return SweepMode(self.modes)

    @property
    def known_mass(self) -> KnownMass | None:
        """The test mass as a rigid body."""
        return None if self.test_mass is None else KnownMass(**self.test_mass.model_dump())


class _DesignedPlan(BaseModel):
    """Designed sweeps in the order in which they run."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    robot: str
    sweeps: tuple[PlannedSweep, ...]
    dropped: tuple[DroppedPose, ...]  # the reason names the blocks that are left out in the pose
    duration: float  # s

    @property
    def limits(self) -> Limits:
        """What these sweeps may do."""
        return limits(sweep.spec.block for sweep in self.sweeps)


class DiagnosisPlan(_DesignedPlan):
    """A whole campaign of a diagnosis."""

    request: DiagnosisRequest
    candidates: int  # poses of the grid
    measurable: int  # of them free


class ExperimentPlan(_DesignedPlan):
    """The sweeps that a diagnosis asks for."""

    request: ExperimentRequest


def limits(blocks: Iterable[str]) -> Limits:
    """What sweeps of these blocks may do: as any other, but for the travel and the speed of wide and fast ones."""
    widest = max(FAST if block.endswith("fast") else WIDE if block.endswith("wide") else 1.0 for block in blocks)
    return Limits(travel=SWAY * widest * SLOW, sweep_velocity=PEAK)
