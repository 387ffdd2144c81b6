"""Requests and documents of the plans of every kind: sweeps, initial analysis, trajectories, diagnosis, experiment."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Annotated, Literal, cast

from pydantic import BaseModel, ConfigDict, Field, model_validator

from drivers.ports import NoiseCommand, SineCommand, SweepCommand, SweepMode
from service import BadInput
from service.identification.design.diagnosis_sweeps import BLOCKS, FAST, SLOW, WIDE, WIDE_LINES
from service.identification.design.excitation import Noise, Sines
from service.identification.design.pose_selection import Criterion
from service.identification.estimates.torque_gain import KnownMass
from service.model import Robot, SweepSpec
from service.model.results.part import Shown, Table, columns_of_sweeps
from service.planning.campaigns.stored_plan import MadeFor
from service.planning.safety.envelope_check import MethodLimits
from service.store.documents import LARGEST_ID, BoltedMass

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOVE_VELOCITY = 0.1  # rad/s (m/s), between poses; default of a request
SAMPLE_RATE = 250.0  # Hz, default of a request
LARGEST_CHOICE = 1000  # poses
USUAL_CHOICE = 24  # poses, without a budget
CELL_NAME = r"^([A-Za-z0-9][A-Za-z0-9_-]*)?$"


class _PlanModel(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class PlanRequest(_PlanModel):
    """What to measure. `robot_id` is the service's number of the robot, `cell` the name of a cell's file; empty: the
    cell of the machine.

    One of `poses`, `duration` and `confidence` is the budget; 24 poses if none is named.
    """

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
    # simultaneous sweeps, host-streamed, where they need less robot time than one axis at a time
    simultaneous: bool = False
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
    # campaigns of other robots of the type, at least four: their estimates are the prior of plan and estimate
    prior_from: tuple[Annotated[int, Field(ge=1, le=LARGEST_ID)], ...] = Field(default=(), max_length=100)

    @model_validator(mode="before")
    @classmethod
    def _one_budget(cls, given: object) -> object:
        if not isinstance(given, dict):
            return given
        fields = cast("dict[object, object]", given)
        named = [budget for budget in ("poses", "duration", "confidence") if fields.get(budget) is not None]
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
            if not frequency > Sines.lines[0]:
                raise BadInput(
                    f"locked_rotor.{joint}", f"{frequency} Hz is not above the lowest line of {Sines.lines[0]} Hz"
                )
        for line in self.lines:
            if not (line >= 1 and line.is_integer()):
                raise BadInput("lines", f"{line} Hz is not a whole number of Hz above 0: a sweep's period is 1 s")
        if len(set(self.lines)) < len(self.lines):
            raise BadInput("lines", "names a frequency twice")
        for field in ("lines", "prior_from", "warm_up"):
            if self.simultaneous and getattr(self, field):
                raise BadInput(field, "cannot be combined with simultaneous sweeps: leave it out, or plan single axes")
        least = 10 * max(self.lines or Sines.lines)
        if self.sample_rate < least:
            raise BadInput("sample_rate", f"{self.sample_rate} Hz is below {least} Hz, 10 times the highest line")


class PlannedLeg(_PlanModel):
    """Move one joint to `target`, rad (m)."""

    joint: str
    target: float


class PlannedSweep(_PlanModel):
    """One sweep, the legs that lead from the previous pose to its pose, and its limits."""

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
            sines=tuple(SineCommand(sine.frequency, sine.amplitude, sine.phase) for sine in spec.sines),
            period=spec.period or 0.0,
            periods=spec.periods or 0,
            ramp=self.ramp,
            settle=self.settle,
            sample_rate=spec.sample_rate,
            velocity_limit=self.velocity_limit,
            effort_limit=self.effort_limit,
            position_window=self.position_window,
        )


class DroppedPose(_PlanModel):
    """A chosen pose that cannot be measured."""

    pose: tuple[float, ...]
    reason: str


class SparePose(_PlanModel):
    """A pose that does not improve the confidence; `number` in the order of choice, from 1."""

    number: int
    pose: tuple[float, ...]


class Alternative(_PlanModel):
    """A plan that was compared: groups of axes that move at once, () for one axis at a time; what it needs, s, and
    predicts, percent of J. `reason`: why it is not possible.
    """

    groups: tuple[tuple[str, ...], ...]
    realisations: int
    duration: float | None = None
    confidence: float | None = None
    reason: str = ""


def at_once(sweeps: Sequence[PlannedSweep]) -> tuple[tuple[int, ...], ...]:
    """Numbers, from 1, of the sweeps that run at the same time, by their block."""
    blocks: dict[str, list[int]] = {}
    for number, sweep in enumerate(sweeps, 1):
        if sweep.spec.axes_at_once > 1:
            blocks.setdefault(sweep.spec.block, []).append(number)
    return tuple(map(tuple, blocks.values()))


class PlanDocument(Shown, _PlanModel):
    """A complete campaign in the order of its sweeps.

    `condition` and `confidence` are lists in the order of *choice*, after each chosen pose: condition number, null
    while rank deficient, and predicted largest standard deviation of J over the workspace, percent of J, null while
    CAD may matter for J.
    """

    robot: str
    request: PlanRequest
    sweeps: tuple[PlannedSweep, ...]
    dropped: tuple[DroppedPose, ...]
    base_parameters: tuple[str, ...]
    condition: tuple[float | None, ...]
    confidence: tuple[float | None, ...] = ()
    # base parameters that the estimate may leave undetermined, because the sweeps are not better than CAD
    undetermined: tuple[str, ...] = ()
    enough_poses: int | None = None  # so many state a confidence; null: these do, or no such number was found
    spare: tuple[SparePose, ...] = ()
    candidates: int  # poses of the grid, or of its part
    measurable: int  # collision-free, with room for every sweep
    duration: float  # s
    groups: tuple[tuple[str, ...], ...] = ()  # axes that move at once; (): one axis at a time
    compared: tuple[Alternative, ...] = ()  # for a request of simultaneous sweeps
    alone: str = ""  # which of its axes go alone, and why
    made_for: MadeFor | None = None  # None: for any other machine

    def table(self) -> Table:
        """One row a sweep."""
        specs = [sweep.spec for sweep in self.sweeps]
        return Table(
            f"Plan for the robot {self.robot}: {len(specs)} sweeps, {self.duration / 60:.0f} min",
            columns_of_sweeps(specs),
        )

    def plot(self) -> "Axes":
        """Draws the predicted confidence after each chosen pose."""
        from service.model.results import plots  # matplotlib

        return plots.promise(self.confidence)


class PlanFile(BaseModel):
    """What ``sweepid plan --out`` writes, as far as the commands read it."""

    document: PlanDocument


PEAK_VELOCITY = 0.15  # rad/s (m/s), instantaneous: the fast blocks are three times as fast as other sweeps


class DiagnosisRequest(_PlanModel):
    """What to measure for a diagnosis; `varied`, `step` and `cell` as in a plan of sweeps. `poses`: for each axis."""

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

    def check(self, robot: Robot) -> None:
        """Check against the robot, and for consistency. BadInput names the field."""
        grid_of(self).check(robot)
        for block in self.blocks:
            if block not in BLOCKS:
                raise BadInput("blocks", f"unknown block {block}; there are {', '.join(BLOCKS)}")
        if len(set(self.blocks)) < len(self.blocks):
            raise BadInput("blocks", f"names a block twice: {', '.join(self.blocks)}")


class ExperimentRequest(_PlanModel):
    """An experiment with designed sweeps, and the test mass that is mounted; the other fields as in a plan of
    sweeps.
    """

    kind: Literal["experiment"] = "experiment"
    robot_id: int = Field(ge=1, le=LARGEST_ID)
    cell: str = Field(default="", pattern=CELL_NAME)
    modes: Literal["drive_side", "host_streamed"] = "drive_side"
    move_velocity: float = Field(default=MOVE_VELOCITY, ge=1e-5, le=100.0)  # rad/s (m/s)
    test_mass: BoltedMass | None = None

    @property
    def known_mass(self) -> KnownMass | None:
        """The test mass as a rigid body."""
        return None if self.test_mass is None else KnownMass(**self.test_mass.model_dump())


class _DesignedPlan(_PlanModel):
    """Designed sweeps in the order of execution."""

    robot: str
    sweeps: tuple[PlannedSweep, ...]
    dropped: tuple[DroppedPose, ...]  # the reason names the omitted blocks of the pose
    duration: float  # s
    made_for: MadeFor | None = None  # as in a plan of sweeps

    @property
    def limits(self) -> MethodLimits:
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


def limits(blocks: Iterable[str]) -> MethodLimits:
    """Limits for sweeps of these blocks: as usual, except for the travel and speed of wide and fast blocks."""
    widest = max(FAST if block.endswith("fast") else WIDE if block.endswith("wide") else 1.0 for block in blocks)
    # the sines oscillate around the offset motion
    return MethodLimits(travel=1.05 * widest * SLOW, sweep_velocity=PEAK_VELOCITY)


class TrajectoryRequest(_PlanModel):
    """The axes that move at the same time, and their motion; all others stay at the cell's home."""

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


class TrajectoryPlan(_PlanModel):
    """All trajectories in order: for each the sweeps of its axes, one after the other, with the same `block`.

    `condition`: condition number of each trajectory's rows in the base parameters of its axes' efforts. `payload_std`:
    least std of a payload's mass from each with and without it, kg, at torque noise of 0.5 % of rated.
    """

    robot: str
    request: TrajectoryRequest
    sweeps: tuple[PlannedSweep, ...]
    condition: tuple[float, ...]
    payload_std: tuple[float, ...] = ()
    duration: float  # s
    made_for: MadeFor | None = None  # as in a plan of sweeps


class AnalysisRequest(_PlanModel):
    """What to analyse; `varied`, `step` and `cell` as in a plan of sweeps. `poses`: number for each axis."""

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
    sample_rate: float = Field(default=SAMPLE_RATE, ge=4 * Noise.band[1], le=20_000)  # Hz
    move_velocity: float = Field(default=MOVE_VELOCITY, ge=1e-5, le=100.0)  # rad/s (m/s)


class PlannedNoise(_PlanModel):
    """One noise run, the legs that lead to its pose, and its limits."""

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


class AnalysisPlan(_PlanModel):
    """A complete initial analysis in the order of its runs."""

    robot: str
    request: AnalysisRequest
    sweeps: tuple[PlannedNoise | PlannedSweep, ...]
    dropped: tuple[DroppedPose, ...]
    candidates: int  # poses of the grid
    measurable: int  # collision-free, with room for every run
    duration: float  # s
    made_for: MadeFor | None = None  # as in a plan of sweeps


def grid_of(request: AnalysisRequest | DiagnosisRequest) -> PlanRequest:
    """The plan of sweeps with the same axes and grid."""
    return PlanRequest(
        robot_id=request.robot_id,
        cell=request.cell,
        axes=request.axes,
        varied=request.varied,
        step=request.step,
        poses=1,
    )
