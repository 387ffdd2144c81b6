"""Request and plan of exciting trajectories."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from service.planning.campaigns.plan_subject import MadeFor
from service.planning.documents import CELL_NAME, MOVE_VELOCITY, PlannedSweep
from service.store.documents import LARGEST_ID


class TrajectoryRequest(BaseModel):
    """The axes that move at the same time, and their motion; all others stay at the cell's home."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    kind: Literal["trajectory"]
    robot_id: int = Field(ge=1, le=LARGEST_ID)
    cell: str = Field(default="", pattern=CELL_NAME)
    axes: tuple[str, ...] = Field(min_length=2)
    trajectories: int = Field(default=3, ge=1, le=20)
    period: float = Field(default=10.0, ge=2.0, le=60.0)  # s, of the fundamental
    harmonics: int = Field(default=5, ge=1, le=16)
    periods: int = Field(default=2, ge=2, le=10)  # differences between periods give the noise
    velocity: float = Field(default=0.5, gt=0)  # rad/s (m/s), limit of the sum of an axis' amplitudes
    acceleration: float = Field(default=1.0, gt=0)  # rad/s^2 (m/s^2)
    seed: int = Field(default=0, ge=0)  # each seed gives other trajectories
    sample_rate: float = Field(default=100.0, ge=50.0, le=20_000)  # Hz
    move_velocity: float = Field(default=MOVE_VELOCITY, ge=1e-5, le=100.0)  # rad/s (m/s), between trajectories
    # campaign of the same robot whose sweeps the estimate combines with the trajectories
    sweeps: int | None = Field(default=None, ge=1, le=LARGEST_ID)


class TrajectoryPlan(BaseModel):
    """All trajectories in order: for each the sweeps of its axes, one after the other, with the same `block`.

    `condition`: condition number of each trajectory's rows in the base parameters of its axes' efforts.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    robot: str
    request: TrajectoryRequest
    sweeps: tuple[PlannedSweep, ...]
    condition: tuple[float, ...]
    duration: float  # s
    made_for: MadeFor | None = None  # as in a plan of sweeps

    @property
    def at_once(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the sweeps, from 1, of each trajectory."""
        blocks: dict[str, list[int]] = {}
        for number, sweep in enumerate(self.sweeps, 1):
            blocks.setdefault(sweep.spec.block, []).append(number)
        return tuple(tuple(numbers) for numbers in blocks.values())
