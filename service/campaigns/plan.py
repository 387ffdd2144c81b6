"""Plans a campaign: which poses, in which order, over which way, with which sweep in each. Pure and deterministic.

1. Grid: the varied axes on multiples of the step within the joint limits, all other axes at the cell's home.
2. Room: poses that are free with room for the sweep's travel in every requested axis, forward or backward.
3. Choice: greedy by the condition number of the observation matrix, all requested axes stacked (`pose_selection`).
4. Order: a short way through the first poses chosen, up to the one that makes the matrix regular, then a short way
   through the rest (`travel`): a campaign that ends early still has an estimate of all base parameters.
5. Sweeps: designed from the CAD inertia of each pose and checked against the envelope. A pose that has no free way
   from the one before, or whose sweeps do not pass, is dropped with its reason.
"""

import math
from collections.abc import Sequence
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from drivers.ports import Sine as PortSine
from drivers.ports import SweepCommand, SweepMode
from service.campaigns.envelope import Envelope
from service.campaigns.travel import order_poses
from service.cell import Cell
from service.errors import BadInput, EnvelopeViolation
from service.identification.base_parameters import base_parameters
from service.identification.excitation import LINES, Excitation, design_sweep
from service.identification.pose_selection import select_poses
from service.identification.regressor import axis_rows, inertia_rows, lock
from service.recording import Sine, SweepSpec
from service.robot import Robot
from service.store.documents import LARGEST_ID

Array = NDArray[np.float64]

LARGEST_GRID = 100_000  # poses
LEG_OVERHEAD = 1.0  # s to switch an axis on, settle and switch it off


class PlanRequest(BaseModel):
    """What to measure. `robot_id` is the service's number of the robot, `cell` the name of a cell's file."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    robot_id: int = Field(ge=1, le=LARGEST_ID)
    cell: str = Field(default="workshop", pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$")
    axes: tuple[str, ...] = Field(min_length=1)  # joints to measure
    varied: tuple[str, ...] = Field(min_length=1)  # joints whose positions make the grid
    step: float = Field(default=5.0, ge=0.5, le=90.0)  # deg (prismatic: cm) between grid positions
    poses: int = Field(default=24, ge=1, le=1000)
    modes: Literal["drive_side", "host_streamed", "one_host_streamed"] = "drive_side"  # the last: one sweep an axis
    lines: tuple[float, ...] = Field(
        default=(), max_length=16
    )  # whole Hz, sines of every sweep; (): as the method has it
    sample_rate: float = Field(default=250.0, gt=0, le=20_000)  # Hz
    move_velocity: float = Field(default=0.1, gt=0)  # rad/s (m/s), between poses; for the estimate of the duration
    locked_rotor: dict[str, float] = {}  # lowest first locked-rotor frequency by joint, Hz, where it is known


class PlannedLeg(BaseModel):
    """Move one joint to `target`, rad (m)."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    joint: str
    target: float


class PlannedSweep(BaseModel):
    """One sweep, the legs that lead to its pose from the one before, and the limits it runs under."""

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
        """The sweep as the drive port takes it."""
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
    """A chosen pose that cannot be measured after all."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    pose: tuple[float, ...]
    reason: str


class PlanDocument(BaseModel):
    """A whole campaign in the order of its sweeps; `condition` after each chosen pose, null while rank deficient."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    robot: str
    request: PlanRequest
    sweeps: tuple[PlannedSweep, ...]
    dropped: tuple[DroppedPose, ...]
    base_parameters: tuple[str, ...]
    condition: tuple[float | None, ...]
    candidates: int  # poses of the grid
    measurable: int  # of them free, with room for every sweep
    duration: float  # s


def build_plan(robot: Robot, request: PlanRequest, cell: Cell) -> PlanDocument:
    """The plan of a request; BadInput names the field that cannot be met."""
    _check(robot, request)
    envelope = Envelope(robot, cell)
    axes = [robot.index(joint) for joint in request.axes]
    home = np.array(cell.home_pose(robot.joints))
    grid = _grid(robot, request, envelope, home)
    grid_free = grid[envelope.checker.collision_free(grid)]
    candidates = grid_free[_has_room(envelope, grid_free, axes)]
    if len(candidates) < request.poses:
        raise BadInput(
            "poses",
            f"{request.poses} wanted, but of {len(grid)} poses of the grid only {len(candidates)} are free "
            f"with room for a sweep of every axis in cell {cell.name}",
        )

    rows, names = _observation(robot, request, home, candidates)
    selection = select_poses(rows, request.poses)
    chosen = _in_order(candidates[list(selection.picks)], selection.condition, home)

    sweeps, dropped = _Course(robot, request, envelope, candidates).through(chosen, home)
    if not sweeps:
        raise BadInput("poses", f"none of the chosen poses can be measured, the first because: {dropped[0].reason}")
    return PlanDocument(
        robot=robot.name,
        request=request,
        sweeps=sweeps,
        dropped=dropped,
        base_parameters=names,
        condition=tuple(value if math.isfinite(value) else None for value in selection.condition),
        candidates=len(grid),
        measurable=len(candidates),
        duration=sum(sweep.duration for sweep in sweeps),
    )


def workspace_grid(robot: Robot, request: PlanRequest, cell: Cell) -> Array:
    """All collision-free poses (m, n) of the request's grid."""
    _check(robot, request)
    envelope = Envelope(robot, cell)
    grid = _grid(robot, request, envelope, np.array(cell.home_pose(robot.joints)))
    return grid[envelope.checker.collision_free(grid)]


def _check(robot: Robot, request: PlanRequest) -> None:
    for field in ("axes", "varied", "locked_rotor"):
        joints: Sequence[str] = tuple(getattr(request, field))
        for joint in joints:
            if joint not in robot.joints:
                raise BadInput(field, f"unknown joint {joint}; robot {robot.name} has {', '.join(robot.joints)}")
        if len(set(joints)) < len(joints):
            raise BadInput(field, f"names a joint twice: {', '.join(joints)}")
    for joint, frequency in request.locked_rotor.items():
        if not frequency > LINES[0]:
            raise BadInput(f"locked_rotor.{joint}", f"{frequency} Hz is not above the lowest line of {LINES[0]} Hz")
    for line in request.lines:
        if not (line >= 1 and line.is_integer()):
            raise BadInput("lines", f"{line} Hz is not a whole number of Hz above 0: a sweep's period is 1 s")
    if len(set(request.lines)) < len(request.lines):
        raise BadInput("lines", "names a frequency twice")
    highest = max(request.lines or LINES)
    if request.sample_rate < 10 * highest:
        raise BadInput("sample_rate", f"{request.sample_rate} Hz is below {10 * highest} Hz, 10 times the highest line")


def _grid(robot: Robot, request: PlanRequest, envelope: Envelope, home: Array) -> Array:
    """Poses (m, n): the varied joints on multiples of the step inside their limits, the others at home."""
    positions: list[Array] = []
    for joint in request.varied:
        index = robot.index(joint)
        prismatic = robot.chain.joints[index].kind == "prismatic"
        step = request.step / 100 if prismatic else math.radians(request.step)
        low, high = envelope.joint_range(index)
        if not math.isfinite(high - low):
            low, high = -math.pi, math.pi - step / 2
        numbers = np.arange(math.ceil(low / step), math.floor(high / step) + 1, dtype=np.float64)
        positions.append(numbers * step)
    count = math.prod(len(one) for one in positions)
    if count > LARGEST_GRID:
        raise BadInput("step", f"{request.step} gives a grid of {count} poses, limit {LARGEST_GRID}")
    grid = np.tile(home, (count, 1))
    grid[:, [robot.index(joint) for joint in request.varied]] = list(product(*positions))
    return grid


def _has_room(envelope: Envelope, poses: Array, axes: Sequence[int]) -> NDArray[np.bool_]:
    """Poses (m, n) from which every axis can sweep forward or backward."""
    room = np.ones(len(poses), dtype=bool)
    for axis in axes:
        room &= _room(envelope, poses, axis, 1) | _room(envelope, poses, axis, -1)
    return room


def _room(envelope: Envelope, poses: Array, axis: int, direction: int) -> NDArray[np.bool_]:
    """Poses whose joint `axis` can turn by the whole travel and its margins in one direction."""
    limits = envelope.limits
    start = poses.copy()
    start[:, axis] -= direction * limits.window_margin
    way = direction * (limits.travel + 2 * limits.window_margin)
    low, high = envelope.joint_range(axis)
    ends = np.stack([start[:, axis], start[:, axis] + way])
    room = (ends.min(0) >= low) & (ends.max(0) <= high)
    room[room] = envelope.checker.travel_free(start[room], axis, way)
    return room


def _observation(robot: Robot, request: PlanRequest, home: Array, candidates: Array) -> tuple[Array, tuple[str, ...]]:
    """Rows (m, axes, base parameters) of the candidates, and the parameters' names.

    Joints that neither move nor vary are locked, as the identification does.
    """
    free = sorted(robot.index(joint) for joint in {*request.axes, *request.varied})
    fixed = {k: float(home[k]) for k in range(len(robot.axes)) if k not in free}
    chain = lock(robot.chain, fixed)
    own = [free.index(robot.index(joint)) for joint in request.axes]
    base = base_parameters(chain, tuple(sorted(own)))
    rows = np.stack([axis_rows(chain, k, candidates[:, free])[:, list(base.columns)] for k in own], axis=1)
    return rows, base.names


def _in_order(chosen: Array, condition: Sequence[float], home: Array) -> Array:
    """The chosen poses (k, n) in the order of the way."""
    singular = sum(not math.isfinite(value) for value in condition)
    first, rest = chosen[: singular + 1], chosen[singular + 1 :]
    first = first[order_poses(first, home)]
    return np.vstack([first, rest[order_poses(rest, first[-1])]])


class _Course:
    """Builds the sweeps along the way."""

    def __init__(self, robot: Robot, request: PlanRequest, envelope: Envelope, candidates: Array) -> None:
        self._robot, self._request, self._envelope = robot, request, envelope
        self._heaviest = {joint: float(self._load_inertia(joint, candidates).max()) for joint in request.axes}

    def through(self, poses: Array, home: Array) -> tuple[tuple[PlannedSweep, ...], tuple[DroppedPose, ...]]:
        """Sweeps of all axes in each of the poses (m, n) in turn, starting at home; and the poses left out."""
        here = [float(position) for position in home]
        streamed: set[str] = set()  # axes that have their host-streamed sweep
        sweeps: list[PlannedSweep] = []
        dropped: list[DroppedPose] = []
        clock = 0.0
        for pose in poses:
            goal = tuple(float(position) for position in pose)
            try:
                planned, end = self._pose(here, goal, streamed, len(sweeps), clock)
            except (EnvelopeViolation, BadInput) as error:
                dropped.append(DroppedPose(pose=goal, reason=str(error)))
                continue
            streamed |= {sweep.spec.axis for sweep in planned if sweep.mode is SweepMode.HOST_STREAMED}
            here, clock = end, clock + sum(sweep.duration for sweep in planned)
            sweeps += planned
        return tuple(sweeps), tuple(dropped)

    def _pose(
        self, here: list[float], goal: tuple[float, ...], streamed: set[str], number: int, clock: float
    ) -> tuple[list[PlannedSweep], list[float]]:
        """The sweeps of all axes in one pose, and where they leave the robot."""
        planned: list[PlannedSweep] = []
        for joint in self._request.axes:
            legs = self._envelope.order_of_legs(here, goal)
            excitation = self._design(joint, goal)
            mode = self._mode(joint, streamed)
            sweep = self._sweep(f"{number + len(planned) + 1:04d}", joint, goal, excitation, mode)
            self._envelope.check_sweep(sweep.command(), goal)
            way = sum(abs(target - position) for position, target in _moves(here, legs))
            travelling = way / self._request.move_velocity + LEG_OVERHEAD * (len(legs) + 1)
            sweep = sweep.model_copy(
                update={
                    "legs": tuple(PlannedLeg(joint=self._robot.joints[k], target=target) for k, target in legs),
                    "spec": sweep.spec.model_copy(update={"started_at": clock + travelling}),
                    "duration": travelling + excitation.duration,
                }
            )
            clock += sweep.duration
            here = list(goal)
            here[self._robot.index(joint)] += excitation.travel
            planned.append(sweep)
        return planned, here

    def _mode(self, joint: str, streamed: set[str]) -> SweepMode:
        modes = self._request.modes
        if modes == "host_streamed" or (modes == "one_host_streamed" and joint not in streamed):
            return SweepMode.HOST_STREAMED
        return SweepMode.DRIVE_SIDE

    def _sweep(
        self, name: str, joint: str, pose: tuple[float, ...], excitation: Excitation, mode: SweepMode
    ) -> PlannedSweep:
        """The sweep with its limits and without a way to it."""
        envelope, index = self._envelope, self._robot.index(joint)
        sway = sum(sine.amplitude / (math.pi * sine.frequency) for sine in excitation.sines)
        margin = envelope.limits.window_margin + sway
        start, end = pose[index], pose[index] + excitation.travel
        return PlannedSweep(
            spec=SweepSpec(
                id=name,
                axis=joint,
                pose=pose,
                offset_velocity=excitation.offset_velocity,
                sines=tuple(
                    Sine(frequency=sine.frequency, amplitude=sine.amplitude, phase=sine.phase)
                    for sine in excitation.sines
                ),
                period=excitation.period,
                periods=excitation.periods,
                measure_from=excitation.measure_from,
                sample_rate=self._request.sample_rate,
                block="forward" if excitation.offset_velocity > 0 else "backward",
            ),
            mode=mode,
            ramp=excitation.ramp,
            settle=excitation.settle,
            velocity_limit=envelope.velocity_limit(index),
            effort_limit=envelope.effort_limit(index),
            position_window=(min(start, end) - margin, max(start, end) + margin),
            legs=(),
            duration=excitation.duration,
        )

    def _design(self, joint: str, pose: tuple[float, ...]) -> Excitation:
        """The sweep of one axis in a pose, forward where there is room, else backward."""
        envelope, index = self._envelope, self._robot.index(joint)
        poses = np.array([pose])
        direction = 1 if _room(envelope, poses, index, 1)[0] else -1
        load = float(self._load_inertia(joint, poses)[0])
        lowest = self._request.locked_rotor.get(joint)
        axis = self._robot.axis(joint)
        velocity = envelope.velocity_limit(index)
        # the sines may take what friction and gravity leave over, the CAD inertia being wrong by its prior
        prior = self._robot.prior
        reach = (pose[index] - envelope.limits.travel, pose[index] + envelope.limits.travel)
        gravity = (1 + prior.gravity) * envelope.gravity_effort(index, pose, reach)
        friction = (1 + prior.viscous_friction) * (axis.viscous_friction or 0.0) * velocity
        spare = envelope.effort_limit(index) - gravity - friction - envelope.limits.breakaway * axis.rated_effort
        if not spare > 0:
            raise BadInput(joint, f"gravity of {gravity:.4g} leaves no effort for a sweep in this pose")
        return design_sweep(
            self._robot,
            joint,
            np.array(pose),
            load_inertia=load,
            lines=sorted(self._request.lines),
            # at constant stiffness the frequency goes with 1 / sqrt(inertia)
            locked_rotor_frequency=None if lowest is None else lowest * math.sqrt(self._heaviest[joint] / load),
            direction=direction,
            travel=_TRAVEL_SHARE * envelope.limits.travel,
            velocity_limit=velocity,
            effort_limit=spare / (1 + 2 * prior.inertia) / 2,
        )

    def _load_inertia(self, joint: str, poses: Array) -> Array:
        chain = self._robot.chain
        return inertia_rows(chain, self._robot.index(joint), poses) @ chain.inertial.ravel()


_TRAVEL_SHARE = 0.95  # of the travel that the offset takes; the sines sway on both sides of it


def _moves(here: Sequence[float], legs: Sequence[tuple[int, float]]) -> list[tuple[float, float]]:
    """From and to of each leg."""
    pose = list(here)
    moves: list[tuple[float, float]] = []
    for joint, target in legs:
        moves.append((pose[joint], target))
        pose[joint] = target
    return moves
