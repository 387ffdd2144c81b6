"""Plans a campaign: poses, their order, the path, and the sweep in each. Pure and deterministic.

1. Grid: the varied axes on multiples of the step within the joint limits, all other axes at the cell's home.
2. Room: collision-free poses with room for the travel of the sweep in each requested axis, forward or backward.
3. Choice: greedy by the request's criterion on the observation matrix, all requested axes stacked (`pose_selection`),
      one pose after the other until the budget is used: number, time, or confidence. A confidence is reached if the
      predicted one is, and if CAD will hardly matter for J by the estimate's own rule: otherwise it states none. If
      the choice was continued only for that rule, poses that are not needed for both are left out again.
      With a number or a time, the choice is continued to find out how many poses are enough for the rule.
4. Sweeps: designed from the CAD inertia of each pose, and checked against the envelope.
5. Order: a short path through the first poses chosen, up to the one that makes the matrix regular, then a short path
   through the rest (`travel`): a campaign that ends early still has an estimate of all base parameters.
A pose without a free path from home or from the previous pose, or with sweeps outside the envelope, is dropped with its
reason. With a confidence, other poses are chosen in its place.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from drivers.ports import SweepMode
from service import BadInput, EnvelopeViolation
from service.identification.axis.ideal_frequency import InitialAnalysis
from service.identification.design.excitation import Excitation, realisations
from service.identification.design.pose_selection import without_gain
from service.identification.estimates.robot_type import RobotType
from service.model import Array, Robot, SweepPurpose, SweepSpec, together
from service.model.configuration import Cell
from service.planning.documents import (
    Alternative,
    DroppedPose,
    PlanDocument,
    PlannedSweep,
    PlanRequest,
    SparePose,
    at_once,
)
from service.planning.path import LEG_OVERHEAD, SweepPath
from service.planning.poses import ChosenPose, Groups, PoseChooser, SweepDesign, grid, has_room, least_duration, observe
from service.planning.safety.envelope_check import Envelope
from service.planning.safety.travel import order_poses


def build_plan(
    robot: Robot,
    request: PlanRequest,
    cell: Cell,
    analyses: Mapping[str, InitialAnalysis] | None = None,
    earlier: RobotType | None = None,
) -> PlanDocument:
    """The plan of a request; BadInput names the field that is impossible.

    `analyses`: the initial analysis that the request names, by joint. `earlier`: robots of the type; with a confidence
    as the budget, their estimates leave less to measure.
    """
    request.check(robot)
    place = _Place.of(robot, request, cell, analyses or {})
    possible: list[PlanDocument] = []
    compared: list[Alternative] = []
    if not request.simultaneous:
        return _build(place, request, earlier, ())
    for groups, count in _ways(request, place.design):
        asked = request.model_copy(update={"realisations": count})
        tried = Alternative(groups=groups, realisations=count)
        try:
            plan = _build(place, asked, earlier, groups)
        except BadInput as error:
            compared.append(tried.model_copy(update={"reason": str(error)}))
        else:
            possible.append(plan.model_copy(update={"request": request}))
            about = {"duration": plan.duration, "confidence": plan.confidence[-1]}
            compared.append(tried.model_copy(update=about))
    if not possible:
        raise BadInput("simultaneous", compared[-1].reason)
    best = min(possible, key=lambda plan: (_robot_time(plan, request), plan.duration))
    return best.model_copy(update={"compared": tuple(compared), "alone": _alone(best, place.design)})


def _ways(request: PlanRequest, design: SweepDesign) -> Iterator[tuple[Groups, int]]:
    """Groups and realisations to compare: one axis at a time; the three groupings that show most per time, also with
    two and eight times as many realisations: the way back measures as well, and moves are saved.
    """
    yield (), request.realisations
    groupings = [groups for groups in _groupings(request.axes, design) if len(groups) < len(request.axes)]
    merits = {groups: design.merit(groups) for groups in groupings}
    for groups in sorted(filter(lambda one: merits[one] > -math.inf, groupings), key=lambda one: -merits[one])[:3]:
        for count in sorted({min(20, times * request.realisations) for times in (1, 2, 8)}):
            yield groups, count


def _groupings(axes: Sequence[str], design: SweepDesign) -> Iterator[Groups]:
    """All divisions of axes into groups of one to six that hold their sweeps in some pose."""
    if not axes:
        yield ()
        return
    for number in range(min(6, len(axes))):
        for others in combinations(axes[1:], number):
            group = (axes[0], *others)
            if design.factor(group).any():
                for rest in _groupings([joint for joint in axes if joint not in group], design):
                    yield (group, *rest)


def _alone(plan: PlanDocument, design: SweepDesign) -> str:
    """Which axes go alone in a plan of simultaneous sweeps, and why; "" if none does."""
    axes = plan.request.axes
    alone = [group[0] for group in plan.groups or [(joint,) for joint in axes] if len(group) == 1]
    pairs = [(k, j) for joint in alone for other in axes if other != joint for k, j in ((joint, other), (other, joint))]
    if not pairs:
        return ""
    moved = {(k, j): float(np.median(design.moved((k, j))[:, 0, 1])) for k, j in pairs}
    (k, j), limit = max(pairs, key=lambda pair: moved[pair]), SweepDesign.most_moved
    text = f"{', '.join(alone)} alone: "
    if moved[k, j] > limit:
        return text + f"the sines of {j} would move {k} by {moved[k, j]:.2g} times its own, limit {limit:.2g}"
    return text + f"{plan.duration:.4g} s, which no group would shorten"


def _robot_time(plan: PlanDocument, request: PlanRequest) -> float:
    """Robot time to the request's confidence or, without one, to 1 %, s: a standard deviation falls as the square root
    of time.
    """
    predicted = plan.confidence[-1] if plan.confidence else None
    if predicted is None:
        return math.inf
    return plan.duration * max(predicted / (request.confidence or 1.0), 1.0 if request.confidence else 0.0) ** 2


@dataclass(frozen=True)
class _Place:
    """A robot in its cell with the candidates of a request: those of `poses` of the grid with room for its sweeps."""

    robot: Robot
    envelope: Envelope
    home: Array
    poses: int
    candidates: Array  # (m, n)
    design: SweepDesign

    @classmethod
    def of(cls, robot: Robot, request: PlanRequest, cell: Cell, analyses: Mapping[str, InitialAnalysis]) -> "_Place":
        """BadInput if there are fewer candidates than the request's poses."""
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
        design = SweepDesign(robot, request, envelope, candidates, analyses)
        return cls(robot, envelope, home, len(poses), candidates, design)


def _build(place: _Place, request: PlanRequest, earlier: RobotType | None, groups: Groups) -> PlanDocument:
    """The plan with the axes of `groups` at once; (): one at a time."""
    robot, envelope, home = place.robot, place.envelope, place.home
    observed = observe(robot, request, home, groups)
    chooser = PoseChooser(request, envelope, place.design, observed, place.candidates, earlier, groups)
    itinerary = _Sequence(robot, request, envelope, groups)
    dropped: tuple[DroppedPose, ...] = ()
    while True:
        choice = chooser.choose(dropped)
        chosen = choice.poses
        sweeps, unreached, count = _within_duration(itinerary, request, chosen, home)
        dropped = (*choice.refused, *unreached)
        if request.confidence is None or not unreached:
            break
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
        candidates=place.poses,
        measurable=len(place.candidates),
        duration=sum(sweep.duration for sweep in sweeps),
        groups=groups,
    )


def _within_duration(
    itinerary: "_Sequence", request: PlanRequest, chosen: Sequence[ChosenPose], home: Array
) -> tuple[tuple[PlannedSweep, ...], tuple[DroppedPose, ...], int]:
    """The sweeps of as many of the first poses as fit into the request's duration, or of all; the dropped poses; and
    the number of poses.
    """
    count = len(chosen)
    while True:
        sweeps, dropped = itinerary.through(chosen[:count], home)
        duration = sum(sweep.duration for sweep in sweeps)
        if request.duration is None or duration <= request.duration:
            return sweeps, dropped, count
        if count <= 1:
            raise BadInput(
                "duration",
                f"{request.duration:.4g} s are too short for one pose; at least {duration:.4g} s are required",
            )
        count = max(1, count - math.ceil((duration - request.duration) / duration * count))


def _finite(values: Sequence[float]) -> tuple[float | None, ...]:
    return tuple(value if math.isfinite(value) else None for value in values)


@dataclass(frozen=True)
class _Run:
    """One sweep of a pose."""

    joint: str
    excitation: Excitation
    purpose: SweepPurpose = SweepPurpose.INERTIA
    repeat: int = 0

    @property
    def back(self) -> "_Run":
        """In the opposite direction."""
        return replace(self, excitation=replace(self.excitation, offset_velocity=-self.excitation.offset_velocity))


class _Sequence:
    """The sweeps of the request in chosen poses."""

    def __init__(self, robot: Robot, request: PlanRequest, envelope: Envelope, groups: Groups) -> None:
        self._robot, self._request, self._envelope = robot, request, envelope
        self._groups = groups

    def through(
        self, chosen: Sequence[ChosenPose], home: Array
    ) -> tuple[tuple[PlannedSweep, ...], tuple[DroppedPose, ...]]:
        """Sweeps of all axes in each of the poses on a short path from home; and the omitted poses.

        The first pose begins with the warm-up: rounds of its sweeps that are recorded but not used for the inertias.
        """
        path = SweepPath[PlannedSweep](self._robot, self._envelope, home, self._request.move_velocity)
        streamed: set[str] = set()  # axes that already have their host-streamed sweep
        dropped: list[DroppedPose] = []
        leg = LEG_OVERHEAD * self._request.move_velocity
        for one in _in_order(chosen, home, leg, at_once=bool(self._groups)):
            goal, count = tuple(float(position) for position in one.pose), len(path.sweeps)
            warm_up = () if path.sweeps else self._warm_up(one.sweeps)
            try:
                with path.all_or_none():
                    if self._groups:
                        self._at_once(path, one, streamed)
                    for run in () if self._groups else (*warm_up, *self._measuring(one.pose, one.sweeps)):
                        spec, travel = self._spec(goal, run), run.excitation.travel
                        path.add(path.of_sines(spec, self._mode(run, streamed), run.excitation, travel), travel)
            except (EnvelopeViolation, BadInput) as error:
                dropped.append(DroppedPose(pose=goal, reason=str(error)))
            streamed |= {each.spec.axis for each in path.sweeps[count:] if each.mode is SweepMode.HOST_STREAMED}
        return tuple(path.sweeps), tuple(dropped)

    def _at_once(self, path: SweepPath[PlannedSweep], chosen: ChosenPose, streamed: set[str]) -> None:
        """The sweeps of each group; every second realisation is the way back. An axis begins at the end of its way
        that is nearer.
        """
        runs, count, start = self._measuring(chosen.pose, chosen.sweeps), self._request.realisations, chosen.pose.copy()
        for number in range(0, len(runs), count):
            index, travel = self._robot.index(runs[number].joint), runs[number].excitation.travel
            if abs(path.here[index] - start[index] - travel) < abs(path.here[index] - start[index]):
                start[index] += travel
                runs[number : number + count] = [run.back for run in runs[number : number + count]]
        pose = tuple(start.tolist())
        for group in self._groups:
            for number in range(count):
                moving = [run.back if number % 2 else run for run in runs[number::count] if run.joint in group]
                block = together(len(at_once(path.sweeps)) + 1, len(group))
                change = {"excitation": "trajectory", "block": block} if len(group) > 1 else {}
                specs = [self._spec(pose, run).model_copy(update=change) for run in moving]
                travels = [run.excitation.travel for run in moving]
                mode = SweepMode.HOST_STREAMED if len(group) > 1 else self._mode(moving[0], streamed)
                path.add_together(
                    [
                        path.of_sines(spec, mode, run.excitation, travel)
                        for spec, run, travel in zip(specs, moving, travels, strict=True)
                    ],
                    travels,
                )
                pose = tuple(path.here)

    def _runs(self, excitations: Sequence[Excitation]) -> list[_Run]:
        """One sweep of each axis."""
        return [_Run(joint, sweep) for joint, sweep in zip(self._request.axes, excitations, strict=True)]

    def _measuring(self, pose: Array, excitations: Sequence[Excitation]) -> list[_Run]:
        """The sweeps in all their realisations; each pose and axis has its own phases."""
        place = [round(1e4 * float(position)) % 2**32 for position in pose]
        return [
            replace(run, excitation=one)
            for run in self._runs(excitations)
            for one in realisations(run.excitation, self._request.realisations, [self._robot.index(run.joint), *place])
        ]

    def _warm_up(self, excitations: Sequence[Excitation]) -> list[_Run]:
        """Complete rounds of all axes for the requested time."""
        rounds = math.ceil(self._request.warm_up / least_duration(excitations))
        return [
            replace(run, purpose=SweepPurpose.WARM_UP, repeat=n)
            for n in range(rounds)
            for run in self._runs(excitations)
        ]

    def _mode(self, run: _Run, streamed: set[str]) -> SweepMode:
        modes = self._request.modes
        first = run.purpose is SweepPurpose.INERTIA and run.joint not in streamed
        if modes == "host_streamed" or (modes == "one_host_streamed" and first):
            return SweepMode.HOST_STREAMED
        return SweepMode.DRIVE_SIDE

    def _spec(self, pose: tuple[float, ...], run: _Run) -> SweepSpec:
        excitation = run.excitation
        towards = "forward" if excitation.offset_velocity > 0 else "backward"
        return SweepSpec(
            id="0000",  # the path numbers it
            axis=run.joint,
            pose=pose,
            offset_velocity=excitation.offset_velocity,
            sines=excitation.sines,
            period=excitation.period,
            periods=excitation.periods,
            measure_from=excitation.measure_from,
            sample_rate=self._request.sample_rate,
            repeat=run.repeat,
            block=run.purpose.value if run.purpose is SweepPurpose.WARM_UP else towards,
        )


def _in_order(chosen: Sequence[ChosenPose], home: Array, leg: float, *, at_once: bool) -> list[ChosenPose]:
    """A short path through the poses that make the matrix regular, then one through the others; one through all where
    axes move `at_once`, since such a campaign does not end early.
    """
    regular = len(chosen) if at_once else sum(not math.isfinite(one.condition) for one in chosen) + 1
    here = home
    ordered: list[ChosenPose] = []
    for part in (chosen[:regular], chosen[regular:]):
        if part:
            poses = np.array([one.pose for one in part])
            ordered += [part[k] for k in order_poses(poses, here, leg)]
            here = ordered[-1].pose
    return ordered
