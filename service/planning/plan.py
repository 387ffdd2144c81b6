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
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.errors import BadInput, EnvelopeViolation
from service.geometry.cell import Cell
from service.identification.axis.ideal_frequency import AxisAnalysis
from service.identification.design.excitation import Excitation
from service.identification.design.pose_selection import choices, conditions
from service.identification.design.predicted_confidence import PredictedConfidence, needed, without_gain
from service.planning.candidates import grid, has_room, workspace_grid
from service.planning.documents import (
    LARGEST_CHOICE,
    USUAL_CHOICE,
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
    itinerary = SweepSequence(robot, request, envelope)
    dropped: tuple[DroppedPose, ...] = ()
    while True:
        choice = _choose(request, envelope, design, observed, candidates, dropped)
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


@dataclass(frozen=True)
class _Choice:
    """Poses in the order of choice until the budget is used (k), and what is predicted after each.

    `percent`: confidence by the sweeps alone; `determined` (>= k): base parameters (p,) that the estimate determines,
    also after the poses that were tried beyond the budget; `refused`: poses that would have been chosen but have no
    path from home, or no sweep.
    """

    poses: list[ChosenPose]
    percent: list[float]
    determined: list[NDArray[np.bool_]]
    refused: list[DroppedPose]

    @property
    def promised(self) -> list[float]:
        """Confidence that the estimate will state after each pose, percent; inf if it will state none."""
        known = zip(self.percent, self.determined, strict=False)
        return [percent if determined.all() else math.inf for percent, determined in known]

    def enough(self, count: int) -> int | None:
        """Least number of poses beyond `count` that determine everything; None if `count` do, or if none is known."""
        complete = [n for n, determined in enumerate(self.determined, 1) if n >= count and determined.all()]
        return complete[0] if complete and complete[0] > count else None


def _choose(
    request: PlanRequest,
    envelope: Envelope,
    design: SweepDesign,
    observed: Observation,
    candidates: Array,
    without: Sequence[DroppedPose],
) -> _Choice:
    """The choice of a request, none of them `without`; BadInput if the requested confidence is out of reach."""
    sweeps: dict[int, tuple[Excitation, ...]] = {}
    refused = list(without)
    closed = {one.pose for one in without}

    def accept(candidate: int) -> bool:
        pose = tuple(float(position) for position in candidates[candidate])
        if pose in closed:
            return False
        try:
            envelope.order_of_legs(tuple(observed.home), pose)
            sweeps[candidate] = tuple(design.excitation(joint, candidate) for joint in request.axes)
        except (EnvelopeViolation, BadInput) as error:
            refused.append(DroppedPose(pose=pose, reason=str(error)))
            return False
        return True

    rows = observed.rows(candidates)
    workspace = observed.workspace(candidates)
    inertia = observed.inertia(workspace)
    seen, spread = observed.rows(workspace), observed.spread(float(inertia.max()))
    predicted = PredictedConfidence(seen, inertia, spread)
    shown: dict[int, Array] = {}  # information of the sweeps in a candidate

    def measure(pick: int) -> None:
        if pick not in shown:
            told = zip(request.axes, sweeps[pick], strict=True)
            once = np.array([design.information(joint, pick, sweep) for joint, sweep in told])
            shown[pick] = request.realisations * once
        predicted.add(rows[pick], shown[pick])
        determined.append(predicted.determined())

    chosen: list[int] = []
    condition: list[float] = []
    percent: list[float] = []
    determined: list[NDArray[np.bool_]] = []
    duration = 0.0
    wanted, reached = request.confidence, False
    picks = choices(rows, request.criterion, candidates, observed.home, accept)
    for pick, number in picks:
        measure(pick)
        chosen.append(pick)
        condition.append(number)
        percent.append(predicted.percent())
        duration += request.realisations * least_duration(sweeps[pick])
        reached = wanted is not None and percent[-1] <= wanted and bool(determined[-1].all())
        full = len(chosen) == (request.poses or LARGEST_CHOICE) or (request.duration or math.inf) < duration
        if reached or full:
            break
    if wanted is not None and chosen and not reached:
        raise BadInput(
            "confidence",
            f"{wanted:.4g} % requested, but the best {len(chosen)} of {len(candidates)} "
            f"measurable poses {_shortfall(request, observed, predicted)}",
        )
    if wanted is not None and len(chosen) > 1 and percent[-2] <= wanted:  # continued only to determine everything
        chosen = [chosen[n] for n in needed(predicted, [(rows[pick], shown[pick]) for pick in chosen], wanted)]
        condition = conditions(rows, chosen)
        predicted = PredictedConfidence(seen, inertia, spread)
        percent.clear()
        determined.clear()
        for pick in chosen:
            measure(pick)
            percent.append(predicted.percent())
    count = len(chosen)
    reported = refused.copy()  # without those beyond the budget
    while chosen and not determined[-1].all() and len(determined) < count + USUAL_CHOICE:
        beyond = next(picks, None)
        if beyond is None:
            break
        measure(beyond[0])
    poses = [ChosenPose(candidates[k], number, sweeps[k]) for k, number in zip(chosen, condition, strict=True)]
    return _Choice(poses, percent, determined, reported)


def _shortfall(request: PlanRequest, observed: Observation, predicted: PredictedConfidence) -> str:
    """What the poses lack, and for which axes."""
    unknown = ~predicted.determined()
    percent = predicted.percent_by_axis()
    if not unknown.any():
        return f"reach only {percent.max():.4g} % ({request.axes[int(percent.argmax())]})"
    names = ", ".join(name for name, open_ in zip(observed.names, unknown, strict=True) if open_)
    axes = ", ".join(joint for joint, on in zip(request.axes, predicted.depending(unknown), strict=True) if on)
    return (
        f"are not better than CAD for {names}, so the estimate would state no confidence of J; "
        f"J of {axes} depends on them"
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
