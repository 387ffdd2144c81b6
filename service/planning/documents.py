"""Request and document of a plan."""

from typing import Literal, cast

from pydantic import BaseModel, ConfigDict, Field, model_validator

from drivers.ports import Sine as PortSine
from drivers.ports import SweepCommand, SweepMode
from service.identification.design.excitation import LINES
from service.identification.design.pose_selection import Criterion
from service.model.errors import BadInput
from service.model.recording import SweepSpec
from service.model.results.table import Shown, Table, columns_of_sweeps
from service.model.robot import Robot
from service.planning.campaigns.plan_subject import MadeFor
from service.store.documents import LARGEST_ID

MOVE_VELOCITY = 0.1  # rad/s (m/s), between poses; default of a request
SAMPLE_RATE = 250.0  # Hz, default of a request
LARGEST_CHOICE = 1000  # poses
USUAL_CHOICE = 24  # poses, without a budget
BUDGETS = ("poses", "duration", "confidence")
CELL_NAME = r"^([A-Za-z0-9][A-Za-z0-9_-]*)?$"


class PlanRequest(BaseModel):
    """What to measure. `robot_id` is the service's number of the robot, `cell` the name of a cell's file; empty: the
    cell of the machine.

    One of `poses`, `duration` and `confidence` is the budget; 24 poses if none is named.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    robot_id: int = Field(ge=1, le=LARGEST_ID)
    cell: str = Field(default="", pattern=CELL_NAME)
    axes: tuple[str, ...] = Field(min_length=1)  # joints to measure
    varied: tuple[str, ...] = Field(min_length=1)  # joints whose positions form the grid
    step: float = Field(default=5.0, ge=0.5, le=90.0)  # deg (prismatic: cm) between grid positions
    criterion: Criterion = Criterion.D_OPTIMAL  # defines the best next pose
    poses: int | None = Field(default=None, ge=1, le=LARGEST_CHOICE)
    duration: float | None = Field(default=None, gt=0)  # s, including moves: as many poses as fit
    # percent, largest std of J over the workspace: as many poses as needed; the campaign ends when it is reached
    confidence: float | None = Field(default=None, ge=1e-6)
    # sweeps of an axis in a pose with different phases: two or more separate noise from nonlinear distortion
    realisations: int = Field(default=1, ge=1, le=20)
    modes: Literal["drive_side", "host_streamed", "one_host_streamed"] = "drive_side"  # the last: one sweep an axis
    lines: tuple[float, ...] = Field(
        default=(), max_length=16
    )  # integer Hz, sines of every sweep; (): those of the method
    sample_rate: float = Field(default=SAMPLE_RATE, gt=0, le=20_000)  # Hz
    move_velocity: float = Field(
        default=MOVE_VELOCITY, ge=1e-5, le=100.0
    )  # rad/s (m/s), between poses; for the estimate of the duration
    warm_up: float = Field(default=0.0, ge=0, le=7200)  # s of sweeps in the first pose, only for the temperature
    locked_rotor: dict[str, float] = {}  # lowest first locked-rotor frequency by joint, Hz, if known
    # campaign of an initial analysis: its locked-rotor and ideal frequencies are used, its drive trains are the prior
    analysis: int | None = Field(default=None, ge=1, le=LARGEST_ID)

    @model_validator(mode="before")
    @classmethod
    def _one_budget(cls, given: object) -> object:
        if not isinstance(given, dict):
            return given
        fields = cast("dict[object, object]", given)
        named = [budget for budget in BUDGETS if fields.get(budget) is not None]
        if len(named) > 1:
            raise ValueError(f"{' and '.join(named)} are budgets: give one of them")
        return fields if named else fields | {"poses": USUAL_CHOICE}

    def check(self, robot: Robot) -> None:
        """Check against the robot, and for consistency. BadInput names the field."""
        for field, joints in (("axes", self.axes), ("varied", self.varied), ("locked_rotor", tuple(self.locked_rotor))):
            for joint in joints:
                if joint not in robot.joints:
                    raise BadInput(field, f"unknown joint {joint}; robot {robot.name} has {', '.join(robot.joints)}")
            if len(set(joints)) < len(joints):
                raise BadInput(field, f"names a joint twice: {', '.join(joints)}")
        for joint, frequency in self.locked_rotor.items():
            if not frequency > LINES[0]:
                raise BadInput(f"locked_rotor.{joint}", f"{frequency} Hz is not above the lowest line of {LINES[0]} Hz")
        for line in self.lines:
            if not (line >= 1 and line.is_integer()):
                raise BadInput("lines", f"{line} Hz is not a whole number of Hz above 0: a sweep's period is 1 s")
        if len(set(self.lines)) < len(self.lines):
            raise BadInput("lines", "names a frequency twice")
        least = 10 * max(self.lines or LINES)
        if self.sample_rate < least:
            raise BadInput("sample_rate", f"{self.sample_rate} Hz is below {least} Hz, 10 times the highest line")


class PlannedLeg(BaseModel):
    """Move one joint to `target`, rad (m)."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    joint: str
    target: float


class PlannedSweep(BaseModel):
    """One sweep, the legs that lead from the previous pose to its pose, and its limits."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    spec: SweepSpec
    mode: SweepMode
    ramp: float
    settle: float
    velocity_limit: float
    effort_limit: float
    position_window: tuple[float, float]
    legs: tuple[PlannedLeg, ...]
    duration: float  # s, legs and sweep

    def command(self) -> SweepCommand:
        """The sweep as a command for the drive port."""
        spec = self.spec
        return SweepCommand(
            joint=spec.axis,
            mode=self.mode,
            offset_velocity=spec.offset_velocity,
            sines=tuple(PortSine(sine.frequency, sine.amplitude, sine.phase) for sine in spec.sines),
            period=spec.period or 0.0,
            periods=spec.periods or 0,
            ramp=self.ramp,
            settle=self.settle,
            sample_rate=spec.sample_rate,
            velocity_limit=self.velocity_limit,
            effort_limit=self.effort_limit,
            position_window=self.position_window,
        )


class DroppedPose(BaseModel):
    """A chosen pose that cannot be measured."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    pose: tuple[float, ...]
    reason: str


class SparePose(BaseModel):
    """A pose that does not improve the confidence; `number` in the order of choice, from 1."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    number: int
    pose: tuple[float, ...]


class PlanDocument(Shown, BaseModel):
    """A complete campaign in the order of its sweeps.

    `condition` and `confidence` are lists in the order of *choice*, after each chosen pose: condition number, null
    while rank deficient, and predicted largest standard deviation of J over the workspace, percent of J, null while
    the estimate may leave a base parameter undetermined.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    robot: str
    request: PlanRequest
    sweeps: tuple[PlannedSweep, ...]
    dropped: tuple[DroppedPose, ...]
    base_parameters: tuple[str, ...]
    condition: tuple[float | None, ...]
    confidence: tuple[float | None, ...] = ()
    # base parameters that the estimate may leave undetermined, because the sweeps are not better than CAD
    undetermined: tuple[str, ...] = ()
    enough_poses: int | None = None  # so many determine all; null: these do, or no such number was found
    spare: tuple[SparePose, ...] = ()
    candidates: int  # poses of the grid
    measurable: int  # collision-free, with room for every sweep
    duration: float  # s
    made_for: MadeFor | None = None  # None: for any other machine

    def table(self) -> Table:
        """One row a sweep."""
        specs = [sweep.spec for sweep in self.sweeps]
        return Table(
            f"Plan for the robot {self.robot}: {len(specs)} sweeps, {self.duration / 60:.0f} min",
            columns_of_sweeps(specs),
        )
