"""Plans a campaign: poses, their order, the path, and the sweep in each. Pure and deterministic.

1. Grid: the varied axes on multiples of the step within the joint limits, all other axes at the cell's home.
2. Room: collision-free poses with room for the travel of the sweep in each requested axis, forward or backward.
3. Choice: greedy by the request's criterion on the observation matrix, all requested axes stacked (`pose_selection`),
      one pose after the other until the budget is used: number, time, or the predicted confidence.
4. Sweeps: designed from the CAD inertia of each pose, and checked against the envelope.
5. Order: a short path through the first poses chosen, up to the one that makes the matrix regular, then a short path
   through the rest (`travel`): a campaign that ends early still has an estimate of all base parameters.
A pose without a free path from home or from the previous pose, or with sweeps outside the envelope, is dropped with its
reason.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.errors import BadInput, EnvelopeViolation
from service.geometry.cell import Cell
from service.identification.axis.ideal_frequency import AxisAnalysis
from service.identification.design.excitation import Excitation
from service.identification.design.pose_selection import choices
from service.identification.design.predicted_confidence import PredictedConfidence, without_gain
from service.planning.candidates import grid, has_room, workspace_grid
from service.planning.documents import (
    LARGEST_CHOICE,
    DroppedPose,
    PlanDocument,
    PlannedLeg,
    PlannedSweep,
    PlanRequest,
    SparePose,
)
from service.planning.observability import Observation, observe
from service.planning.sweep_design import SweepDesign
from service.planning.sweep_sequence import ChosenPose, SweepSequence, least_duration
from service.robot import Robot
from service.safety.envelope import Envelope

__all__ = ["PlanDocument", "PlanRequest", "PlannedLeg", "PlannedSweep", "build_plan", "workspace_grid"]

Array = NDArray[np.float64]


def build_plan(
    robot: Robot, request: PlanRequest, cell: Cell, analyses: Mapping[str, AxisAnalysis] | None = None
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
    chosen, percent, refused = _choose(request, envelope, design, observed, candidates)
    sweeps, dropped = _within_duration(SweepSequence(robot, request, envelope), request, chosen, home)
    count = len({sweep.spec.pose for sweep in sweeps}) + len(dropped)
    dropped = (*refused, *dropped)
    if not sweeps:
        raise BadInput("poses", f"none of the chosen poses can be measured; reason for the first: {dropped[0].reason}")
    return PlanDocument(
        robot=robot.name,
        request=request,
        sweeps=sweeps,
        dropped=dropped,
        base_parameters=observed.names,
        condition=_finite([one.condition for one in chosen[:count]]),
        confidence=_finite(percent[:count]),
        spare=tuple(
            SparePose(number=n + 1, pose=tuple(chosen[n].pose.tolist())) for n in without_gain(percent[:count])
        ),
        candidates=len(poses),
        measurable=len(candidates),
        duration=sum(sweep.duration for sweep in sweeps),
    )


def _choose(
    request: PlanRequest, envelope: Envelope, design: SweepDesign, observed: Observation, candidates: Array
) -> tuple[list[ChosenPose], list[float], list[DroppedPose]]:
    """Poses in the order of choice until the budget is used; the predicted confidence after each, percent.

    Also the poses that would have been chosen but have no path from home, or no sweep.
    """
    sweeps: dict[int, tuple[Excitation, ...]] = {}
    refused: list[DroppedPose] = []

    def accept(candidate: int) -> bool:
        pose = tuple(float(position) for position in candidates[candidate])
        try:
            envelope.order_of_legs(tuple(observed.home), pose)
            sweeps[candidate] = tuple(design.excitation(joint, candidate) for joint in request.axes)
        except (EnvelopeViolation, BadInput) as error:
            refused.append(DroppedPose(pose=pose, reason=str(error)))
            return False
        return True

    rows = observed.rows(candidates)
    workspace = observed.workspace(candidates)
    predicted = PredictedConfidence(observed.rows(workspace), observed.inertia(workspace))
    chosen: list[ChosenPose] = []
    percent: list[float] = []
    needed = 0.0
    for pick, condition in choices(rows, request.criterion, candidates, observed.home, accept):
        told = zip(request.axes, sweeps[pick], strict=True)
        once = np.array([design.information(joint, pick, sweep) for joint, sweep in told])
        predicted.add(rows[pick], request.realisations * once)
        chosen.append(ChosenPose(candidates[pick], condition, sweeps[pick]))
        percent.append(predicted.percent())
        needed += request.realisations * least_duration(sweeps[pick])
        if request.confidence is not None and percent[-1] <= request.confidence:
            return chosen, percent, refused
        if len(chosen) == (request.poses or LARGEST_CHOICE) or (request.duration or math.inf) < needed:
            break
    if request.confidence is not None and chosen:
        reached = f"reach only {percent[-1]:.4g} %" if math.isfinite(percent[-1]) else "do not determine J everywhere"
        raise BadInput(
            "confidence",
            f"{request.confidence:.4g} % requested, but the best {len(chosen)} of {len(candidates)} "
            f"measurable poses {reached}",
        )
    return chosen, percent, refused


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
