"""Plans a campaign: poses, their order, the path, and the sweep in each. Pure and deterministic.

1. Grid: the varied axes on multiples of the step within the joint limits, all other axes at the cell's home.
2. Room: collision-free poses with room for the travel of the sweep in each requested axis, forward or backward.
3. Choice: greedy by the request's criterion on the observation matrix, all requested axes stacked (`pose_selection`),
      one pose after the other until the budget is used: number, time, or confidence. A confidence is reached if the
      predicted one is, and if the estimate will determine all base parameters by its own rule: otherwise it states
      none. If the choice was continued only for that rule, poses that are not needed for both are left out again.
      With a number or a time, the choice is continued to find out how many poses are enough for the rule.
4. Sweeps: designed from the CAD inertia of each pose, and checked against the envelope.
5. Order: a short path through the first poses chosen, up to the one that makes the matrix regular, then a short path
   through the rest (`travel`): a campaign that ends early still has an estimate of all base parameters.
A pose without a free path from home or from the previous pose, or with sweeps outside the envelope, is dropped with its
reason. With a confidence, other poses are chosen in its place.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.identification.axis.ideal_frequency import InitialAnalysis
from service.identification.design.pose_selection import without_gain
from service.model.configuration import Cell
from service.model.errors import BadInput
from service.model.robot import Robot
from service.planning.candidates import grid, has_room, workspace_grid
from service.planning.documents import (
    DroppedPose,
    PlanDocument,
    PlannedLeg,
    PlannedSweep,
    PlanRequest,
    SparePose,
)
from service.planning.observability import observe
from service.planning.pose_choice import PoseChooser
from service.planning.safety.envelope import Envelope
from service.planning.sweep_design import SweepDesign
from service.planning.sweep_sequence import ChosenPose, SweepSequence

__all__ = ["PlanDocument", "PlanRequest", "PlannedLeg", "PlannedSweep", "build_plan", "workspace_grid"]

Array = NDArray[np.float64]


def build_plan(
    robot: Robot, request: PlanRequest, cell: Cell, analyses: Mapping[str, InitialAnalysis] | None = None
) -> PlanDocument:
    """The plan of a request; BadInput names the field that is impossible.

    `analyses`: the initial analysis that the request names, by joint.
    """
    request.check(robot)
    envelope = Envelope(robot, cell)
    home = np.array(cell.home_pose(robot.joints))
    poses = grid(robot, request, envelope, home)
    free = poses[envelope.checker.collision_free(poses)]
    candidates = free[has_room(envelope, free, [robot.index(joint) for joint in request.axes])]
    if len(candidates) < (request.poses or 1):
        raise BadInput(
            "poses",
            f"{request.poses or 1} requested, but of {len(poses)} poses of the grid only "
            f"{len(candidates)} are collision-free and have room for a sweep of every axis in cell {cell.name}",
        )
    observed = observe(robot, request, home)
    design = SweepDesign(robot, request, envelope, candidates, analyses or {})
    chooser = PoseChooser(request, envelope, design, observed, candidates)
    itinerary = SweepSequence(robot, request, envelope)
    dropped: tuple[DroppedPose, ...] = ()
    while True:
        choice = chooser.choose(dropped)
        chosen = choice.poses
        sweeps, unreached = _within_duration(itinerary, request, chosen, home)
        dropped = (*choice.refused, *unreached)
        if request.confidence is None or not unreached:
            break
    count = len({sweep.spec.pose for sweep in sweeps}) + len(unreached)
    if not sweeps:
        raise BadInput("poses", f"none of the chosen poses can be measured; reason for the first: {dropped[0].reason}")
    return PlanDocument(
        robot=robot.name,
        request=request,
        sweeps=sweeps,
        dropped=dropped,
        base_parameters=observed.names,
        condition=_finite([one.condition for one in chosen[:count]]),
        confidence=_finite(choice.promised[:count]),
        undetermined=tuple(
            name for name, known in zip(observed.names, choice.determined[count - 1], strict=True) if not known
        ),
        enough_poses=choice.enough(count),
        spare=tuple(
            SparePose(number=n + 1, pose=tuple(chosen[n].pose.tolist())) for n in without_gain(choice.percent[:count])
        ),
        candidates=len(poses),
        measurable=len(candidates),
        duration=sum(sweep.duration for sweep in sweeps),
    )


def _within_duration(
    itinerary: SweepSequence, request: PlanRequest, chosen: Sequence[ChosenPose], home: Array
) -> tuple[tuple[PlannedSweep, ...], tuple[DroppedPose, ...]]:
    """The sweeps of as many of the first poses as fit into the request's duration, or of all; and the dropped poses."""
    count = len(chosen)
    while True:
        sweeps, dropped = itinerary.through(chosen[:count], home)
        duration = sum(sweep.duration for sweep in sweeps)
        if request.duration is None or duration <= request.duration:
            return sweeps, dropped
        if count <= 1:
            raise BadInput(
                "duration",
                f"{request.duration:.4g} s are too short for one pose; at least {duration:.4g} s are required",
            )
        count = max(1, count - math.ceil((duration - request.duration) / duration * count))


def _finite(values: Sequence[float]) -> tuple[float | None, ...]:
    return tuple(value if math.isfinite(value) else None for value in values)
