"""The choice of the poses of a plan: from the grid of a request to the poses that use its budget.

First the measurable poses of the grid, then what the sweeps in a pose will be and show, and what the estimate will know
after each chosen pose.
"""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import combinations, product

import numpy as np

from service import BadInput, EnvelopeViolation
from service.identification.axis.ideal_frequency import InitialAnalysis
from service.identification.axis.nominal_priors import model_spread, pose_prior
from service.identification.design.excitation import Excitation, Sines, design_sweep, zippered_lines
from service.identification.design.pose_selection import (
    PredictedConfidence,
    choices,
    conditions,
    needed,
    path_length,
    sweep_information,
)
from service.identification.estimates.estimate import RobotEstimate
from service.identification.estimates.robot_type import RobotType
from service.identification.model import (
    Independence,
    axis_rows,
    coupling_rows,
    gravity_terms,
    inertia_rows,
    inertial_parameters,
    joint_ranges,
    lock,
    parameter_names,
    reduce_columns,
    spread_evenly,
)
from service.identification.model.base_parameters import base_parameters
from service.model import Array, Mask, Robot
from service.model.collision import reachable
from service.model.configuration import Cell
from service.planning.documents import LARGEST_CHOICE, USUAL_CHOICE, DroppedPose, PlanRequest
from service.planning.path import LEG_OVERHEAD
from service.planning.safety.envelope_check import Envelope
from service.planning.safety.travel import order_poses

Groups = tuple[tuple[str, ...], ...]  # of joints that move at once, in the order of the request's axes


def workspace_grid(robot: Robot, request: PlanRequest, cell: Cell) -> Array:
    """All collision-free poses (m, n) of the request's grid."""
    request.check(robot)
    envelope = Envelope(robot, cell)
    poses = grid(robot, request, envelope, np.array(cell.home_pose(robot.joints)))
    return poses[envelope.checker.collision_free(poses)]


def grid(robot: Robot, request: PlanRequest, envelope: Envelope, home: Array) -> Array:
    """Poses (m, n): the varied joints on multiples of the step within their limits, at most one turn; others home.

    Of more than 100,000 a few thousand that fill the grid evenly.
    """
    positions: list[Array] = []
    for joint in request.varied:
        index = robot.index(joint)
        prismatic = robot.chain.joints[index].kind == "prismatic"
        step = request.step / 100 if prismatic else math.radians(request.step)
        low, high = envelope.joint_range(index)
        if not prismatic and high - low > 2 * math.pi:  # beyond one turn, the poses repeat
            low = min(max(low, -math.pi), high - 2 * math.pi)
            high = low + 2 * math.pi - step / 1000
        numbers = np.arange(math.ceil(low / step), math.floor(high / step) + 1, dtype=np.float64)
        positions.append(numbers * step)
    count = math.prod(len(one) for one in positions)
    if count > 100_000:
        sizes = np.array([len(one) for one in positions])
        picks = np.unique(spread_evenly(4096, np.zeros(len(sizes)), sizes).astype(int), axis=0)
        places = np.stack([one[pick] for one, pick in zip(positions, picks.T, strict=True)], axis=1)
    else:
        places = np.array(list(product(*positions)))
    poses = np.tile(home, (len(places), 1))
    poses[:, [robot.index(joint) for joint in request.varied]] = places
    return poses


def has_room(envelope: Envelope, poses: Array, axes: Sequence[int]) -> Mask:
    """Poses (m, n) from which each axis can sweep forward or backward."""
    enough = np.ones(len(poses), dtype=bool)
    for axis in axes:
        left = np.flatnonzero(enough)
        forward = room(envelope, poses[left], axis, 1)
        enough[left[~forward]] = room(envelope, poses[left[~forward]], axis, -1)
    return enough


def room(envelope: Envelope, poses: Array, axis: int, direction: int) -> Mask:
    """Poses in which joint `axis` can move by the whole travel and its margins in one direction."""
    limits = envelope.limits
    start = poses.copy()
    start[:, axis] -= direction * limits.window_margin
    way = direction * (limits.travel + 2 * limits.window_margin)
    low, high = envelope.joint_range(axis)
    ends = np.stack([start[:, axis], start[:, axis] + way])
    inside = (ends.min(0) >= low) & (ends.max(0) <= high)
    inside[inside] = envelope.checker.travel_free(start[inside], axis, way)
    return inside


@dataclass(frozen=True)
class Observability:
    """The chain as used in the identification: joints that neither move nor vary are locked."""

    robot: Robot
    axes: tuple[int, ...]  # measured joints
    free: tuple[int, ...]  # joints that are not locked
    home: Array
    names: tuple[str, ...]  # base parameters
    columns: tuple[int, ...]
    combination: Array  # (p, 11 n) of the parameters of the free joints in the base parameters
    pairs: tuple[tuple[int, int], ...] = ()  # measured joints that move at once: their M_kj is measured as well

    def rows(self, poses: Array) -> Array:
        """Rows (m, axes, base parameters) of J at poses (m, n)."""
        chain = lock(self.robot.chain, _locked(self.home, self.free))
        own = [self.free.index(axis) for axis in self.axes]
        return np.stack([axis_rows(chain, k, poses[:, self.free])[:, self.columns] for k in own], axis=1)

    def measured(self, poses: Array) -> Array:
        """Rows (m, axes + pairs, base parameters) of J and M_kj at poses (m, n)."""
        chain = lock(self.robot.chain, _locked(self.home, self.free))
        coupled = coupling_rows(chain, _numbers(self.pairs, self.free), poses[:, self.free])
        return np.concatenate([self.rows(poses), coupled[..., self.columns]], axis=1)

    def inertia(self, poses: Array) -> Array:
        """Inertia (m, axes) of the CAD model about the axes, kg m^2 (kg)."""
        chain, parameters = self.robot.chain, self.robot.chain.inertial.ravel()
        motors = [self.robot.axes[axis].reflected_motor_inertia or 0.0 for axis in self.axes]
        return np.stack([inertia_rows(chain, axis, poses) @ parameters for axis in self.axes], axis=1) + motors

    def spread(self, largest: float) -> Array:
        """Standard deviations (p,) of the base parameters in the CAD model, as in the estimate (`base_spread`) if the
        measurement agrees with it; `largest`: inertia for a motor without data sheet, kg m^2 (kg).
        """
        chain = lock(self.robot.chain, _locked(self.home, self.free))
        return model_spread(self.robot, chain, self.free, self.combination, largest)

    def workspace(self, stood: Array) -> Array:
        """Poses (w, n) that represent the workspace, as in the estimate (`Estimate.workspace`)."""
        lower, upper = joint_ranges(lock(self.robot.chain, _locked(self.home, self.free)))
        poses = np.tile(self.home, (RobotEstimate.workspace_poses, 1))
        poses[:, self.free] = spread_evenly(RobotEstimate.workspace_poses, lower, upper)
        return reachable(self.robot, stood, poses)


def observe(robot: Robot, request: PlanRequest, home: Array, groups: Groups = ()) -> Observability:
    """Observability with the sweeps of the request; joints neither measured nor varied are locked at `home` (n,).

    `groups`: axes that move at once.
    """
    axes = tuple(robot.index(joint) for joint in request.axes)
    free = tuple(sorted(robot.index(joint) for joint in {*request.axes, *request.varied}))
    chain = lock(robot.chain, _locked(home, free))
    own = tuple(sorted(free.index(axis) for axis in axes))
    pairs = tuple(pair for group in groups for pair in combinations(map(robot.index, group), 2))
    if pairs:
        poses = spread_evenly(Independence.samples, *joint_ranges(chain))
        rows = [
            *(axis_rows(chain, k, poses) for k in own),
            *coupling_rows(chain, _numbers(pairs, free), poses).swapaxes(0, 1),
        ]
        base = reduce_columns(np.vstack(rows), parameter_names(chain))
    else:
        base = base_parameters(chain, own)
    return Observability(robot, axes, free, home, base.names, base.columns, base.combination, pairs)


def _numbers(pairs: Sequence[tuple[int, int]], free: tuple[int, ...]) -> list[tuple[int, int]]:
    return [(free.index(k), free.index(j)) for k, j in pairs]


def _locked(home: Array, free: tuple[int, ...]) -> dict[int, float]:
    return {k: float(position) for k, position in enumerate(home) if k not in free}


class SweepDesign:
    """The sweeps of a request in its candidates (m, n); `analyses`: initial analyses, by joint, as far as known.

    Beside others an axis must keep turning, or it sticks. Its neighbours' sines a_j change its speed by up to
    sum_j |M_kj| w a_j / |i w M_kk + K|, K the gain of its speed control, 0 if it is not known. With M of CAD and its
    deviation this and the axis' own sines must leave a tenth of its offset. Where they do not, the largest of them
    become equal and weaker: of all amplitudes that do, these have the largest product.
    """

    travel_share = 0.95  # of the travel, for the offset motion; the sines oscillate around it
    turning = 0.9  # of the offset, for the sines of an axis and what its neighbours do to it
    weakest = 0.4  # factor of an axis' sines
    most_moved = turning / Sines.load_margin / weakest / 2  # by one neighbour, relative to the own sines

    def __init__(
        self,
        robot: Robot,
        request: PlanRequest,
        envelope: Envelope,
        candidates: Array,
        analyses: Mapping[str, InitialAnalysis],
    ) -> None:
        self._robot, self._request, self._envelope, self._candidates = robot, request, envelope, candidates
        self._analyses = analyses
        chain, parameters = robot.chain, robot.chain.inertial.ravel()
        index = {joint: robot.index(joint) for joint in request.axes}
        self._load = {joint: inertia_rows(chain, k, candidates) @ parameters for joint, k in index.items()}
        self._matrix = self._inertia_matrix()
        self._factors: dict[tuple[str, ...], Array] = {}
        self._designed: dict[tuple[str, int, tuple[float, ...], int | None], Excitation] = {}  # of all groupings
        self._gravity = {
            joint: gravity_terms(chain, parameters, robot.gravity, k, candidates) for joint, k in index.items()
        }

    def excitations(self, candidate: int, groups: Groups) -> tuple[Excitation, ...]:
        """The sweeps of the request's axes in a candidate pose; of `groups` at once. BadInput if one does not fit."""
        found: dict[str, Excitation] = {}
        for group in groups or [(joint,) for joint in self._request.axes]:
            designed = zip(self._at_once(group, candidate).items(), self.factor(group)[candidate], strict=True)
            found |= {joint: one.weaker(float(factor)) for (joint, one), factor in designed}
        return tuple(found[joint] for joint in self._request.axes)

    def factor(self, group: Sequence[str]) -> Array:
        """(m, k) of the sines of axes that move at once; 0 where one would be below `weakest`, or if no sweep fits."""
        own, count = tuple(group), len(group)
        if own not in self._factors:
            parts = self.moved(own) + np.eye(count)
            least = np.sort(parts, axis=2)
            before = np.cumsum(least, axis=2) - least
            most = ((SweepDesign.turning / Sines.load_margin - before) / np.arange(count, 0, -1)).max(axis=2)
            factor = np.minimum(1.0, (most[:, :, None] / np.maximum(parts, 1e-9)).min(axis=1))
            factor[factor.min(axis=1) < SweepDesign.weakest] = 0.0
            self._factors[own] = factor if self._first(own) else np.zeros_like(factor)
        return self._factors[own]

    def moved(self, group: Sequence[str]) -> Array:
        """(m, k, j): most that the sines of axis j change the speed of axis k, relative to those of k."""
        offset = np.array([abs(one.offset_velocity) for one in self._first(group).values()] or [1.0] * len(group))
        own = [self._request.axes.index(joint) for joint in group]
        matrix = np.abs(self._matrix[:, own][:, :, own]) * (1 - np.eye(len(own)))
        held = [(self._robot.axis(joint).speed_gain or 0.0) / (2 * np.pi * Sines.lines[-1]) for joint in group]
        held = np.hypot(np.diagonal(self._matrix, axis1=1, axis2=2)[:, own], held)
        return (1 + self._robot.prior.inertia) * matrix * offset / (held * offset)[:, :, None]

    def merit(self, groups: Groups) -> float:
        """Logarithm of what these sweeps show of all axes per time, up to a constant; -inf with too few poses."""
        factors = [self.factor(group) for group in groups]
        holding = np.hstack(factors).all(axis=1)
        if np.count_nonzero(holding) < (self._request.poses or 1):
            return -math.inf
        shown, seconds = 0.0, LEG_OVERHEAD * (1 + len(self._request.varied))
        for group, factor in zip(groups, factors, strict=True):
            first = list(self._first(group).values())
            seconds += first[0].duration + LEG_OVERHEAD
            power = [sum((one.frequency * one.amplitude) ** 2 for one in sweep.sines) for sweep in first]
            shown += float(np.log(np.multiply(power, first[0].period * first[0].periods)).sum())
            shown += 2 * float(np.log(factor[holding]).mean(axis=0).sum())
        return shown - len(self._request.axes) * math.log(seconds)

    def _first(self, group: Sequence[str]) -> dict[str, Excitation]:
        """The sweeps in the first candidate where they fit, their speeds not yet disturbed; {} if in none."""
        for candidate in range(len(self._candidates)):
            with suppress(BadInput):
                return self._at_once(group, candidate)
        return {}

    def _inertia_matrix(self) -> Array:
        """(m, k, j): M_kj of CAD, with the motors; without the pairs of axes that never move at once."""
        robot, axes = self._robot, self._request.axes
        own = [self._load[joint] + (robot.axis(joint).reflected_motor_inertia or 0.0) for joint in axes]
        found = np.stack(own, -1)[:, :, None] * np.eye(len(axes))
        for k, j in combinations(range(len(axes)), 2) if self._request.simultaneous else ():
            rows = coupling_rows(robot.chain, [(robot.index(axes[k]), robot.index(axes[j]))], self._candidates)
            found[:, k, j] = found[:, j, k] = rows[:, 0] @ inertial_parameters(robot)
        return found

    def _at_once(self, group: Sequence[str], candidate: int) -> dict[str, Excitation]:
        """The sweeps of axes that move at once, their speeds not yet disturbed."""
        if len(group) == 1:
            return {group[0]: self._excitation(group[0], candidate, (), None)}
        window, lines = zippered_lines(len(group))
        return {joint: self._excitation(joint, candidate, own, window) for joint, own in zip(group, lines, strict=True)}

    def _excitation(self, joint: str, candidate: int, zippered: Sequence[float], window: int | None) -> Excitation:
        """The sweep of one axis, forward if there is room, else backward."""
        known = joint, candidate, tuple(zippered), window
        if known not in self._designed:
            self._designed[known] = self._design(joint, candidate, zippered, window)
        return self._designed[known]

    def _design(self, joint: str, candidate: int, zippered: Sequence[float], window: int | None) -> Excitation:
        envelope, index, pose = self._envelope, self._robot.index(joint), self._candidates[candidate]
        direction = 1 if room(envelope, pose[None], index, 1)[0] else -1
        load = float(self._load[joint][candidate])
        axis = self._robot.axis(joint)
        velocity = envelope.velocity_limit(index)
        # the sines may use the effort that friction and gravity leave, with the CAD inertia wrong by its prior
        prior = self._robot.prior
        reach = (pose[index] - envelope.limits.travel, pose[index] + envelope.limits.travel)
        gravity = envelope.gravity_effort(index, tuple(pose), reach)
        friction = (1 + prior.viscous_friction) * (axis.viscous_friction or 0.0) * velocity
        spare = envelope.effort_limit(index) - gravity - friction - envelope.limits.breakaway * axis.rated_effort
        if not spare > 0:
            raise BadInput(joint, f"gravity of {gravity:.4g} leaves no effort for a sweep in this pose")
        return design_sweep(
            self._robot,
            joint,
            pose,
            load_inertia=load,
            lines=zippered or self._lines(joint, load),
            window=window,
            locked_rotor_frequency=self._locked_rotor(joint, candidate),
            direction=direction,
            travel=SweepDesign.travel_share * envelope.limits.travel,
            velocity_limit=velocity,
            effort_limit=spare / (1 + 2 * prior.inertia) / 2,
        )

    def coupled(self, one: str, other: str, candidate: int, excitations: Mapping[str, Excitation]) -> Array:
        """As `information`, (3, 3), of M_kj and the compliances of both: each torque at the other's lines."""
        shown, (k, j) = np.zeros((3, 3)), map(self._request.axes.index, (one, other))
        elastic = [float(self._matrix[candidate, k, j] * self._load[joint][candidate]) for joint in (one, other)]
        for torque, motion in ((one, other), (other, one)):
            sweep, rated = excitations[motion], self._robot.axis(torque).rated_effort
            shown += sweep_information(sweep.sines, sweep.period * sweep.periods, rated, elastic, 0.0)
        return shown

    def information(self, joint: str, candidate: int, excitation: Excitation) -> Array:
        """Predicted information of a sweep in a candidate on inertia and compliance: `sweep_information` (2, 2)."""
        axis, load = self._robot.axis(joint), float(self._load[joint][candidate])
        total = load + (axis.reflected_motor_inertia or 0.0)
        prior = pose_prior(self._robot, self._robot.index(joint), total, self._gravity[joint][candidate])
        return sweep_information(
            excitation.sines,
            excitation.periods * excitation.period,
            axis.rated_effort,
            [load**2],
            float(prior.sigma[1]),
            self._locked_rotor(joint, candidate),
        )

    def _locked_rotor(self, joint: str, candidate: int) -> float | None:
        """With constant stiffness it is proportional to 1 / sqrt(inertia): lowest where the inertia is largest."""
        if joint in self._analyses:
            found = self._analyses[joint].locked_rotor(float(self._load[joint][candidate]))
            return found if math.isfinite(found) else None
        lowest, load = self._request.locked_rotor.get(joint), self._load[joint]
        return None if lowest is None else lowest * math.sqrt(float(load.max() / load[candidate]))

    def _lines(self, joint: str, load: float) -> list[float]:
        """Those of the request, else those of the initial analysis, else [] for those of the method."""
        if self._request.lines or joint not in self._analyses:
            return sorted(self._request.lines)
        return list(self._analyses[joint].lines(load))


@dataclass(frozen=True)
class ChosenPose:
    """`pose` (n,), the condition number with it (inf while singular), and the sweeps of the request's axes."""

    pose: Array
    condition: float
    sweeps: tuple[Excitation, ...]


def least_duration(sweeps: Sequence[Excitation]) -> float:
    """The time for a pose without the path to it, s: its sweeps, each with its way back and switching on and off."""
    return sum(sweep.duration + 2 * LEG_OVERHEAD for sweep in sweeps)


@dataclass(frozen=True)
class Choice:
    """Poses in the order of choice until the budget is used (k), and what is predicted after each (>= k: also after
    the poses that were tried beyond the budget).

    `percent`: confidence by the sweeps alone; `states`: whether the estimate states one; `determined`: base
    parameters (p,) that it determines; `refused`: poses that would have been chosen but have no path from home, or no
    sweep.
    """

    poses: list[ChosenPose]
    percent: list[float]
    states: list[bool]
    determined: list[Mask]
    refused: list[DroppedPose]

    @property
    def promised(self) -> list[float]:
        """Confidence that the estimate will state after each pose, percent; inf if it will state none."""
        known = zip(self.percent, self.states, strict=True)
        return [percent if stated else math.inf for percent, stated in known]

    def enough(self, count: int) -> int | None:
        """Least number of poses beyond `count` with a stated confidence; None if `count` have, or if none is known."""
        complete = [n for n, stated in enumerate(self.states, 1) if n >= count and stated]
        return complete[0] if complete and complete[0] > count else None


@dataclass
class _Prediction:
    """The lists of a `Choice` while poses are added."""

    confidence: PredictedConfidence
    percent: list[float] = field(default_factory=list)
    states: list[bool] = field(default_factory=list)
    determined: list[Mask] = field(default_factory=list)

    def add(self, rows: Array, information: Sequence[Array]) -> None:
        self.confidence.add(rows, information)
        solution = self.confidence.solution()
        self.percent.append(self.confidence.percent())
        self.states.append(self.confidence.determines(solution))
        self.determined.append(solution.determined)


class PoseChooser:
    """Chooses among the `candidates` (m, n) of a request."""

    def __init__(
        self,
        request: PlanRequest,
        envelope: Envelope,
        design: SweepDesign,
        observed: Observability,
        candidates: Array,
        earlier: RobotType | None = None,
        groups: Groups = (),
    ) -> None:
        """`groups`: axes that move at once."""
        self._request, self._envelope, self._design = request, envelope, design
        self._observed, self._candidates, self._groups = observed, candidates, groups
        self._rows = observed.measured(candidates)
        joints = observed.robot.joints
        of = {joint: own for group in groups for joint, own in zip(group, design.factor(group).T, strict=True)}
        pairs = (np.sqrt(of[joints[k]] * of[joints[j]]) for k, j in observed.pairs)
        # of the sines of each row; 0 where the axes of a group cannot hold their sweeps
        factor = np.stack([*(of.get(joint, np.ones(len(candidates))) for joint in request.axes), *pairs], -1)
        self._factor = factor * factor.all(axis=1, keepdims=True)
        workspace = observed.workspace(candidates)
        inertia = observed.inertia(workspace)
        known = None
        if earlier is not None:
            locked = {
                joint: float(observed.home[k])
                for k, joint in enumerate(observed.robot.joints)
                if k not in observed.free
            }
            earlier.check(observed.names, locked)
            known = earlier.information.matrix
        self._known = known
        pairs = [(observed.axes.index(k), observed.axes.index(j)) for k, j in observed.pairs]
        self._workspace = observed.rows(workspace), inertia, observed.spread(float(inertia.max())), known, pairs
        self._sweeps: dict[int, tuple[Excitation, ...]] = {}
        self._shown: dict[int, list[Array]] = {}  # information of the sweeps in a candidate

    def choose(self, without: Sequence[DroppedPose]) -> Choice:
        """The poses of the request, none of them `without`; BadInput if the requested confidence is out of reach."""
        request = self._request
        refused = list(without)
        closed = {one.pose for one in without}
        picks = choices(
            *(self._weighted(closed), request.criterion, self._candidates, self._observed.home),
            lambda candidate: self._accepted(candidate, closed, refused),
            self._known,
            self._seconds if self._groups else None,
            LEG_OVERHEAD * request.move_velocity,
        )
        prediction = self._prediction()
        chosen: list[int] = []
        condition: list[float] = []
        duration, reached = 0.0, False
        for pick, number in picks:
            prediction.add(*self._shows(pick))
            chosen.append(pick)
            condition.append(number)
            duration += self._sweeping(pick)
            reached = prediction.percent[-1] <= (request.confidence or 0.0) and prediction.states[-1]
            full = len(chosen) == (request.poses or LARGEST_CHOICE) or (request.duration or math.inf) < duration
            if reached or full:
                break
        if request.confidence is not None and chosen:
            if not reached:
                raise BadInput("confidence", self._out_of_reach(request.confidence, len(chosen), prediction.confidence))
            # continued only to determine J, or exchanged for quicker ones
            if self._groups or (len(chosen) > 1 and prediction.percent[-2] <= request.confidence):
                shown = [self._shows(pick) for pick in chosen]
                chosen = [chosen[n] for n in needed(prediction.confidence, shown, request.confidence)]
                if self._groups:
                    chosen = self._quicker(chosen, request.confidence, prediction.confidence, closed)
                condition = conditions(self._rows, chosen)
                prediction = self._prediction()
                for pick in chosen:
                    prediction.add(*self._shows(pick))
        reported = refused.copy()  # without those beyond the budget
        while chosen and not prediction.states[-1] and len(prediction.states) < len(chosen) + USUAL_CHOICE:
            beyond = next(picks, None)
            if beyond is None:
                break
            prediction.add(*self._shows(beyond[0]))
        chosen_poses = [
            ChosenPose(self._candidates[pick], number, self._sweeps[pick])
            for pick, number in zip(chosen, condition, strict=True)
        ]
        return Choice(chosen_poses, prediction.percent, prediction.states, prediction.determined, reported)

    def _quicker(
        self, chosen: list[int], wanted: float, predicted: PredictedConfidence, closed: set[tuple[float, ...]]
    ) -> list[int]:
        """Poses exchanged one by one, as long as the robot time falls and `wanted` percent are reached."""
        leg, tried, kept = LEG_OVERHEAD * self._request.move_velocity, 30, 0  # exchanges: those with the shortest way
        while kept < len(chosen):
            old, rest, seconds = chosen[0], chosen[1:], self._robot_time(chosen)
            predicted.remove(*self._shows(old))
            others = np.vstack([self._candidates[rest], self._observed.home])
            away = path_length(self._candidates[:, None], others, leg).min(axis=1)
            away[chosen] = np.inf
            near = np.argsort(away, kind="stable")[:tried].tolist()
            quicker = [(time, k) for k in near if (time := self._robot_time([*rest, k])) < seconds - 0.1]
            for _, new in [*sorted(quicker), (seconds, old)]:
                if self._accepted(new, closed, []):
                    predicted.add(*self._shows(new))
                    if new == old or predicted.reaches(wanted):
                        kept, chosen = kept + 1 if new == old else 0, [*rest, new]
                        break
                    predicted.remove(*self._shows(new))
        return chosen

    def _robot_time(self, picks: Sequence[int]) -> float:
        """Of the sweeps in the candidates `picks` and of a short path through them, s."""
        leg = LEG_OVERHEAD * self._request.move_velocity
        poses, home = self._candidates[list(picks)], self._observed.home
        way = np.vstack([home, poses[order_poses(poses, home, leg)]])
        moves = path_length(way[1:], way[:-1], leg).sum() / self._request.move_velocity
        return len(picks) * self._sweeping(picks[0]) + float(moves)

    def _seconds(self, away: Array) -> Array:
        """Robot time (m,) of the sweeps in candidates at these path lengths (m,), s."""
        sweeps = max((self._sweeping(pick) for pick in list(self._sweeps)[:1]), default=1.0)
        return sweeps + away / self._request.move_velocity

    def _sweeping(self, pick: int) -> float:
        """Robot time of the sweeps in an accepted candidate, s; in groups every way back is a sweep."""
        first = [self._request.axes.index(group[0]) for group in self._groups]
        sweeps = [self._sweeps[pick][k] for k in first]
        once = sum(one.duration + LEG_OVERHEAD for one in sweeps) or least_duration(self._sweeps[pick])
        return self._request.realisations * once

    def _weighted(self, closed: set[tuple[float, ...]]) -> Array:
        """The rows of the candidates, with earlier robots or M_kj by what a sweep shows of each: then all are
        information in the same units.
        """
        if self._known is None and not self._groups:
            return self._rows
        first = next((k for k in range(len(self._candidates)) if self._accepted(k, closed, [])), None)
        if first is None:
            return self._rows
        weight = np.sqrt([one[0, 0] for one in self._shows(first)[1]]) / self._factor[first]
        return self._rows * (weight * self._factor)[..., None]

    def _accepted(self, candidate: int, closed: set[tuple[float, ...]], refused: list[DroppedPose]) -> bool:
        """Whether the candidate has a path from home and its sweeps; otherwise its reason is added to `refused`."""
        pose = tuple(float(position) for position in self._candidates[candidate])
        if pose in closed or not self._factor[candidate].all():
            return False
        if candidate in self._sweeps:
            return True
        try:
            self._envelope.order_of_legs(tuple(self._observed.home), pose)
            self._sweeps[candidate] = self._design.excitations(candidate, self._groups)
        except (EnvelopeViolation, BadInput) as error:
            refused.append(DroppedPose(pose=pose, reason=str(error)))
            return False
        return True

    def _prediction(self) -> _Prediction:
        return _Prediction(PredictedConfidence(*self._workspace))

    def _shows(self, pick: int) -> tuple[Array, Sequence[Array]]:
        """Rows of an accepted candidate and the information of its sweeps, as `PredictedConfidence.add` takes them."""
        if pick not in self._shown:
            sweeps, joints = dict(zip(self._request.axes, self._sweeps[pick], strict=True)), self._observed.robot.joints
            once = [self._design.information(joint, pick, sweep) for joint, sweep in sweeps.items()]
            once += [self._design.coupled(joints[k], joints[j], pick, sweeps) for k, j in self._observed.pairs]
            self._shown[pick] = [self._request.realisations * one for one in once]
        return self._rows[pick], self._shown[pick]

    def _out_of_reach(self, wanted: float, count: int, predicted: PredictedConfidence) -> str:
        """What the best poses lack, and for which axes."""
        request = self._request
        best = f"{wanted:.4g} % requested, but the best {count} of {len(self._candidates)} measurable poses"
        solution, percent = predicted.solution(), predicted.percent_by_axis()
        unknown = ~solution.determined
        if predicted.determines(solution):
            return f"{best} reach only {percent.max():.4g} % ({request.axes[int(percent.argmax())]})"
        names = ", ".join(name for name, open_ in zip(self._observed.names, unknown, strict=True) if open_)
        axes = ", ".join(joint for joint, on in zip(request.axes, predicted.depending(unknown), strict=True) if on)
        return (
            f"{best} are not better than CAD for {names}, so the estimate would state no confidence of J; "
            f"J of {axes} depends on them"
        )
