"""Plans the campaign of a diagnosis: for each axis a few poses with different gravity torques, all blocks in each.

The poses are those of the grid at equal steps of the gravity torque about the axis (CAD model), from the lowest to the
highest at which every block can run: then gravity, springs and load-dependent friction differ between poses. An axis
without gravity torque gets equal steps of its position instead. Of equally good poses, the one at the largest distance
from those already chosen is taken. The sweeps in a pose are the `full_design` of the diagnosis.

An experiment, the next one that a diagnosis proposes, is planned in the same way from designed sweeps.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.ports import SweepMode
from service import BadInput, EnvelopeViolation
from service.identification.design.diagnosis_sweeps import DesignedSweep, full_design
from service.identification.model import gravity_terms
from service.model import Array, Mask, Robot
from service.model.configuration import Cell
from service.planning.documents import (
    DiagnosisPlan,
    DiagnosisRequest,
    DroppedPose,
    ExperimentPlan,
    ExperimentRequest,
    PlannedSweep,
    grid_of,
    limits,
)
from service.planning.machine_setup import DriveAxis, on_machine
from service.planning.path import SweepPath
from service.planning.poses import grid, room
from service.planning.safety.envelope_check import Envelope
from service.planning.safety.travel import order_poses


def build_diagnosis_plan(robot: Robot, request: DiagnosisRequest, cell: Cell) -> DiagnosisPlan:
    """The plan of the campaign of a diagnosis; BadInput names the field that is impossible."""
    request.check(robot)
    envelope = Envelope(robot, cell, limits(request.blocks))
    home = np.array(cell.home_pose(robot.joints))
    poses = grid(robot, grid_of(request), envelope, home)
    free = poses[envelope.checker.collision_free(poses)]
    way = _DesignedPath(robot, request, envelope, home)
    refused: list[DroppedPose] = []
    for joint in request.axes:
        candidates = free[_has_room(envelope, free, robot.index(joint), request.blocks)]
        if len(candidates) < request.poses:
            raise BadInput(
                "poses",
                f"{request.poses} requested, but of {len(poses)} poses of the grid only "
                f"{len(candidates)} are collision-free and have room for every block of {joint} in cell {cell.name}",
            )
        chosen, left_out = _choose(robot, request, envelope, joint, candidates, home)
        refused += left_out
        in_order = chosen[order_poses(chosen, np.array(way.path.here))]
        way.follow(_designed(robot, request, joint, in_order))
    return DiagnosisPlan(
        robot=robot.name,
        request=request,
        sweeps=tuple(way.path.sweeps),
        dropped=(*refused, *way.dropped),
        candidates=len(poses),
        measurable=len(free),
        duration=way.path.duration,
    )


def build_experiment_plan(
    robot: Robot, request: ExperimentRequest, designed: Sequence[DesignedSweep], cell: Cell
) -> ExperimentPlan:
    """The plan of designed sweeps, in their order; BadInput if none of them can be run.

    A block that leaves the envelope in a pose, or a pose without a collision-free path, is omitted with its reason.
    """
    if not designed:
        raise BadInput("experiment", "has no sweeps")
    for sweep in designed:
        robot.index(sweep.spec.axis)
    envelope = Envelope(robot, cell, limits(sweep.spec.block for sweep in designed), request.known_mass)
    way = _DesignedPath(robot, request, envelope, np.array(cell.home_pose(robot.joints)))
    way.follow(designed)
    if not way.path.sweeps:
        raise BadInput("experiment", f"none of its sweeps can be run; reason for the first: {way.dropped[0].reason}")
    return ExperimentPlan(
        robot=robot.name,
        request=request,
        sweeps=tuple(way.path.sweeps),
        dropped=tuple(way.dropped),
        duration=way.path.duration,
    )


@dataclass(frozen=True, slots=True)
class ExperimentPlace:
    """Where the experiments of a robot would run."""

    request: ExperimentRequest
    cell: Cell
    drives: tuple[DriveAxis, ...]

    def runnable(self, robot: Robot, designed: Sequence[DesignedSweep]) -> tuple[tuple[DesignedSweep, ...], str]:
        """The designed sweeps that can be run, and the reason for the first that cannot, or ""."""
        try:
            plan = build_experiment_plan(on_machine(robot, self.drives), self.request, designed, self.cell)
        except BadInput as error:
            return (), error.reason
        planned = {(sweep.spec.pose, sweep.spec.block) for sweep in plan.sweeps}
        kept = tuple(sweep for sweep in designed if (sweep.spec.pose, sweep.spec.block) in planned)
        return kept, plan.dropped[0].reason if plan.dropped else ""


def spread(robot: Robot, index: int, candidates: Array) -> Array:
    """The quantity (m,) that varies over poses (m, n): gravity torque, N m; without weight the position, rad (m)."""
    chain = robot.chain
    gravity = gravity_terms(chain, chain.inertial.ravel(), robot.gravity, index, candidates)[:, 0]
    carries = np.ptp(gravity) > 0.01 * robot.axes[index].rated_effort  # else the axis has no weight to speak of
    return gravity if carries else candidates[:, index]


def _choose(
    robot: Robot, request: DiagnosisRequest, envelope: Envelope, joint: str, candidates: Array, home: Array
) -> tuple[Array, list[DroppedPose]]:
    """Poses (k, n), at most as many as requested, in which every block can run; and the rejected ones."""
    value = spread(robot, robot.index(joint), candidates)
    step = 0.05 * max(float(np.ptp(value)), 1e-9)  # poses so near to the wanted value are equally good
    open_, chosen, refused = np.ones(len(candidates), dtype=bool), list[int](), list[DroppedPose]()
    for wanted in np.linspace(float(value.min()), float(value.max()), request.poses).tolist():
        away = _distance(candidates, candidates[chosen] if chosen else home[None])
        misses = np.floor(np.abs(value - wanted) / step)
        for pick in [int(k) for k in np.lexsort((-away, misses)) if open_[k]][:25]:
            open_[pick] = False
            reason = _refusal(robot, request, envelope, joint, candidates[pick], home)
            if not reason:
                chosen.append(pick)
                break
            refused.append(DroppedPose(pose=tuple(candidates[pick].tolist()), reason=reason))
    if not chosen:
        raise BadInput("poses", f"no pose of {joint} can be measured; reason for the first: {refused[0].reason}")
    return candidates[chosen], refused


def _refusal(robot: Robot, request: DiagnosisRequest, envelope: Envelope, joint: str, pose: Array, home: Array) -> str:
    """The reason why a pose cannot be measured, or ""."""
    way = _DesignedPath(robot, request, envelope, home)
    try:
        envelope.order_of_legs(tuple(home.tolist()), tuple(pose.tolist()))
    except EnvelopeViolation as error:
        return str(error)
    way.follow(_designed(robot, request, joint, pose[None]))
    return way.dropped[0].reason if way.dropped else ""


def _designed(robot: Robot, request: DiagnosisRequest, joint: str, poses: Array) -> tuple[DesignedSweep, ...]:
    return full_design(
        robot, joint, poses, repeats=request.repeats, sample_rate=request.sample_rate, blocks=request.blocks
    )


def _has_room(envelope: Envelope, poses: Array, index: int, blocks: Iterable[str]) -> Mask:
    """Poses with room for the widest block, in each direction that occurs."""
    enough = np.ones(len(poses), dtype=bool)
    for direction in {-1 if block.startswith("backward") else 1 for block in blocks}:
        left = np.flatnonzero(enough)
        enough[left] = room(envelope, poses[left], index, direction)
    return enough


def _distance(poses: Array, others: Array) -> Array:
    """Distance from each pose (m, n) to the nearest of others (k, n), summed over the joints: (m,)."""
    return np.abs(poses[:, None] - others[None]).sum(axis=-1).min(axis=-1)


class _DesignedPath:
    """Designed sweeps along the path. A block that is not possible in a pose is omitted there with all repeats."""

    def __init__(
        self, robot: Robot, request: DiagnosisRequest | ExperimentRequest, envelope: Envelope, home: Array
    ) -> None:
        self.path = SweepPath[PlannedSweep](robot, envelope, home, request.move_velocity)
        self._mode = SweepMode(request.modes)
        self._refused: dict[tuple[tuple[float, ...], str], str] = {}  # by pose and block

    @property
    def dropped(self) -> tuple[DroppedPose, ...]:
        """The omitted sweeps: poses, each with the blocks that have the same reason."""
        blocks: dict[tuple[tuple[float, ...], str], list[str]] = {}
        for (pose, block), reason in self._refused.items():
            blocks.setdefault((pose, reason), []).append(block)
        return tuple(
            DroppedPose(pose=pose, reason=f"{', '.join(names)}: {reason}") for (pose, reason), names in blocks.items()
        )

    def follow(self, designed: Iterable[DesignedSweep]) -> None:
        """Add sweeps in their order."""
        for sweep in designed:
            place, travel = (
                (sweep.spec.pose, sweep.spec.block),
                sweep.spec.offset_velocity * (sweep.duration - sweep.ramp),
            )
            if place in self._refused:
                continue
            try:
                self.path.add(self.path.of_sines(sweep.spec, self._mode, sweep, travel), travel)
            except EnvelopeViolation as error:
                self._refused[place] = str(error)
