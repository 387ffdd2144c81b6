"""Request and plan of an initial analysis."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from drivers.ports import NoiseCommand, SweepMode
from service.identification.design.excitation import HIGHEST
from service.model.recording import SweepSpec
from service.planning.campaigns.plan_subject import MadeFor
from service.planning.documents import (
    CELL_NAME,
    MOVE_VELOCITY,
    SAMPLE_RATE,
    DroppedPose,
    PlannedLeg,
    PlannedSweep,
    PlanRequest,
)
from service.store.documents import LARGEST_ID


class AnalysisRequest(BaseModel):
    """What to analyse; `varied`, `step` and `cell` as in a plan of sweeps. `poses`: number for each axis."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    kind: Literal["analysis"]
    robot_id: int = Field(ge=1, le=LARGEST_ID)
    cell: str = Field(default="", pattern=CELL_NAME)
    axes: tuple[str, ...] = Field(min_length=1)
    varied: tuple[str, ...] = Field(min_length=1)
    step: float = Field(default=10.0, ge=0.5, le=90.0)  # deg (prismatic: cm)
    poses: int = Field(default=6, ge=1, le=100)
    repeats: int = Field(default=2, ge=1, le=10)  # of forward and backward noise in each pose
    # None: noise if the machine can inject torque; a stepped sine needs no torque injection
    excitation: Literal["noise", "stepped_sine"] | None = None
    sample_rate: float = Field(default=SAMPLE_RATE, ge=4 * HIGHEST, le=20_000)  # Hz
    move_velocity: float = Field(default=MOVE_VELOCITY, ge=1e-5, le=100.0)  # rad/s (m/s)

    def as_sweeps(self) -> PlanRequest:
        """The plan of sweeps with the same axes and grid."""
        return PlanRequest(
            robot_id=self.robot_id, cell=self.cell, axes=self.axes, varied=self.varied, step=self.step, poses=1
        )


class PlannedNoise(BaseModel):
    """One noise run, the legs that lead to its pose, and its limits."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    spec: SweepSpec
    effort: float  # N m (N), RMS
    lowest: float  # Hz
    highest: float  # Hz
    seed: int
    softening: float
    ramp: float
    settle: float
    velocity_limit: float
    effort_limit: float
    position_window: tuple[float, float]
    legs: tuple[PlannedLeg, ...]
    duration: float  # s, legs and run

    @property
    def mode(self) -> SweepMode:
        return SweepMode.DRIVE_SIDE

    def command(self) -> NoiseCommand:
        """The run as a command for the drive port."""
        spec = self.spec
        return NoiseCommand(
            joint=spec.axis,
            offset_velocity=spec.offset_velocity,
            effort=self.effort,
            lowest=self.lowest,
            highest=self.highest,
            period=spec.period or 0.0,
            periods=spec.periods or 0,
            seed=self.seed,
            softening=self.softening,
            ramp=self.ramp,
            settle=self.settle,
            sample_rate=spec.sample_rate,
            velocity_limit=self.velocity_limit,
            effort_limit=self.effort_limit,
            position_window=self.position_window,
        )


class AnalysisPlan(BaseModel):
    """A complete initial analysis in the order of its runs."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    robot: str
    request: AnalysisRequest
    sweeps: tuple[PlannedNoise | PlannedSweep, ...]
    dropped: tuple[DroppedPose, ...]
    candidates: int  # poses of the grid
    measurable: int  # collision-free, with room for every run
    duration: float  # s
    made_for: MadeFor | None = None  # as in a plan of sweeps
