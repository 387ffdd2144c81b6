r"""From the spectra of a campaign to its estimate: axis inertias, base parameters, Table 1.

The inertias J of each axis (`axis_estimate`) with their covariance C are the right-hand side of  J = W beta  over all
axes (`least_squares`), W in the base parameters of the chain in which every joint that never moved is locked. Sweeps
that do not fit the others are named and get a lower weight (below). A misfit of J = W beta beyond chance on an
axis (chi-squared at `CHANCE`) increases the covariance of that axis, so that no standard deviation is smaller than
the residuals. The same set of spectra gives the same estimate, independent of the order of the sweeps: they are
sorted by sweep id first.

Two tests find sweeps that do not fit the others, each with the limit for the worst of n correct sweeps by chance:

- its effort: the residual of its own fit relative to the pooled noise (`joint_fit`): a torque spike, a collision, a
  cable;
- its inertia: the value minus the prediction from all other sweeps of all axes,  e_i = J_i - W_i beta_(-i)  over
  its standard deviation: a wrong pose, another payload, a slipped encoder.

A suspect is never dropped. It gets the variance of its misfit, v + (e^2 - v), the most probable value if it has a
separate error, so its influence decreases as 1/e (iteratively reweighted least squares; weight = v / e^2). If the
whole axis fits badly, the cause is the model and not a sweep: then the errors are scaled by their median.

Sweeps that contradict each other can be suspected in turn: with A down-weighted B fits, so A is released, and so on
without end. If the weights have not converged after 10 rounds, a sweep that is suspected once stays suspected and
steps are halved; that ends the cycle with all of them down-weighted, and the result contains a note.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from itertools import accumulate, pairwise

import numpy as np
from scipy import linalg
from scipy.special import chdtri, ndtri

from service import BadInput
from service.identification.axis.axis_estimate import AxisEstimate, identify_axis
from service.identification.axis.ideal_frequency import InitialAnalysis
from service.identification.axis.joint_fit import FitLimits
from service.identification.axis.known_effects import KnownEffects
from service.identification.axis.nominal_priors import MeasuredInertias, TorqueGain, base_spread, torque_gain
from service.identification.estimates.robot_type import RobotType
from service.identification.model import (
    SAME_POSITION,
    BaseParameters,
    Information,
    LeftOut,
    Solution,
    axis_rows,
    condition_number,
    inertial_parameters,
    joint_ranges,
    lock,
    spread_evenly,
)
from service.identification.model.base_parameters import base_parameters
from service.identification.spectra.frequency_response import Spectrum, check_moved_alone
from service.model import Array, Chain, Robot
from service.model.results.estimate import Suspect, TypePrior

MEDIAN = -float(ndtri(0.25))  # of the size of a standard normal value


class WeightingEnded(Enum):
    """How the weighting ended."""

    SETTLED = "no added variance changes by more than 1 %"
    CONTRADICTION = "sweeps contradict each other: each suspected one stays suspected"
    UNFINISHED = "the added variances still change after 40 rounds"


@dataclass(frozen=True)
class Judged:
    """`extra` (n,) variance to add to each inertia, `errors` (n,) from the prediction by the others, in its standard
    deviations.
    """

    extra: Array
    errors: Array
    left_out: LeftOut
    ended: WeightingEnded


def judge(rows: Array, values: Array, covariances: Sequence[Array], rounds: int = 40) -> Judged:
    """Inertias of all sweeps (n,), their rows (n, p) in the base parameters and their covariance, a block an axis.

    All values must be finite: the caller, which has the sweeps' names, checks that (`estimate`).
    """
    edges = accumulate((len(block) for block in covariances), initial=0)
    parts = [slice(a, b) for a, b in pairwise(edges)]
    limit = -float(ndtri(FitLimits.chance / 2 / len(values)))
    extra, errors = np.zeros((2, len(values)))
    left_out = LeftOut.of(rows, values, covariances)
    own = np.concatenate([np.diag(block) for block in covariances])
    suspected, ended = np.zeros(len(values), dtype=bool), WeightingEnded.UNFINISHED
    for number in range(rounds):
        error, variance = left_out.each()
        chance = variance - extra
        errors = error / np.sqrt(chance)
        scale = np.ones(len(values))
        for part in parts:
            scale[part] = max(1.0, float(np.median(np.abs(errors[part]))) / MEDIAN)
        bad = (np.abs(errors) > limit * scale) & (np.abs(error) > FitLimits.material * np.abs(values))
        # until then a suspicion may be withdrawn; normal convergence takes about six rounds
        held = number >= 10
        suspected = suspected | bad if held else bad
        wanted = np.where(suspected, np.maximum(error**2 - np.where(suspected, chance, 0.0), 0.0), 0.0)
        # two that contradict each other share their difference: full steps would assign it to both and to none in turn
        before, extra = extra, (extra + wanted) / 2 if held else wanted
        # relative to each added variance (once held, also to the sweep's own)
        if np.all(np.abs(extra - before) <= 1e-2 * (np.abs(before) + (own if held else 0.0))):
            ended = WeightingEnded.CONTRADICTION if held else WeightingEnded.SETTLED
            break
        enlarged = [block + np.diag(extra[part]) for block, part in zip(covariances, parts, strict=True)]
        left_out = LeftOut.of(rows, values, enlarged)
    return Judged(extra, errors, left_out, ended)


@dataclass(frozen=True)
class HeldOutPoses:
    """Inertias (n,) of an axis predicted from the sweeps of other poses.

    `error` = measured - predicted; `std`: its standard deviation, inf if the other poses do not determine it.
    """

    error: Array
    std: Array


@dataclass(frozen=True)
class RobotEstimate:
    """The complete estimate of a robot from a set of spectra."""

    workspace_poses = 2000  # poses that represent the workspace if no collision-free grid is given

    robot: Robot
    chain: Chain  # unlocked joints only
    unlocked: tuple[int, ...]  # their numbers in the robot
    poses: Array  # (k, all joints) of the sweeps, by sweep id
    axes: tuple[AxisEstimate, ...]
    base: BaseParameters
    nominal: Array  # (11 n,) parameters of the model
    solution: Solution
    spread: Array  # (r,) standard deviations in the nominal model
    condition_number: float
    observation: dict[str, Array]  # rows (n, r) of each axis' sweeps in the base parameters
    chi_squared: dict[str, tuple[float, float]]  # of J = W beta by axis, and its degrees of freedom
    suspects: tuple[Suspect, ...]
    extra: dict[str, Array]  # (n,) variance added to the inertias of each axis, and
    errors: dict[str, Array]  # (n,) from the prediction by all others, in its standard deviations
    held_out: dict[str, HeldOutPoses]
    known: KnownEffects
    prior: TypePrior | None = None  # what earlier robots of its type tell

    @cached_property
    def workspace(self) -> Array:
        """Quasi-random poses (m, all joints) over the limits of the unlocked joints; the locked ones stay locked."""
        lower, upper = joint_ranges(self.chain)
        poses = np.tile(self.poses.mean(axis=0), (RobotEstimate.workspace_poses, 1))
        poses[:, list(self.unlocked)] = spread_evenly(RobotEstimate.workspace_poses, lower, upper)
        return poses

    def identified(self, joint: str, poses: Array) -> Array:
        """Identified inertia (m,) of an axis at poses (m, all joints), kg m^2 (kg)."""
        return self._rows(joint, poses[:, list(self.unlocked)]) @ self.solution.values

    def identified_std(self, joint: str, poses: Array) -> Array:
        """Standard deviation (m,) of `identified`, conditional on the torque gain."""
        rows = self._rows(joint, poses[:, list(self.unlocked)])
        return np.sqrt(np.maximum(np.einsum("mi,ij,mj->m", rows, self.solution.covariance, rows), 0.0))

    def determines(self, poses: Array) -> bool:
        """Whether the nominal model hardly matters for the inertias of all axes at poses (m, all joints)."""
        own = poses[:, list(self.unlocked)]
        return all(self.solution.determines(self._rows(axis.joint, own), self.spread) for axis in self.axes)

    def reference(self, joint: str, poses: Array) -> Array:
        """Inertia (m,) of the nominal model."""
        return axis_rows(self.chain, self._own(joint), poses[:, list(self.unlocked)]) @ self.nominal

    def model_at_sweeps(self, joint: str) -> Array:
        """Identified inertia (n,) of an axis in the poses of its sweeps."""
        return self.observation[joint] @ self.solution.values

    def _own(self, joint: str) -> int:
        return self.unlocked.index(self.robot.index(joint))

    def _rows(self, joint: str, poses: Array) -> Array:
        return self.base.rows(self.chain, self._own(joint), poses)


def check_alive(spectrum: Spectrum) -> None:
    """BadInput if a channel is zero at a commanded line: not recorded, or the axis stood."""
    for name, values in (("effort", spectrum.effort), ("velocity", spectrum.velocity)):
        silent = spectrum.line & (values == 0)
        if silent.any():
            raise BadInput(
                f"sweep {spectrum.spec.id} {name}",
                f"is 0 at the line of {spectrum.frequency[silent][0]:g} Hz: the channel is not "
                "connected, or the axis did not move",
            )


def identify(
    robot: Robot,
    spectra: Sequence[Spectrum],
    analyses: Mapping[str, InitialAnalysis] | None = None,
    gains: Mapping[str, TorqueGain] | None = None,
    known: KnownEffects | None = None,
    earlier: RobotType | None = None,
) -> RobotEstimate:
    """The estimate from these spectra. Raises BadInput if none of them contains inertia (noise runs and stepped sines
    do not), or if axes moved together.

    `analyses` and `gains` by joint: initial analyses, and torque gains calibrated by a test mass. `known`: effects
    of the robot's model in addition to its rigid body. `earlier`: what other robots of its type tell; not used if this
    one differs from them beyond chance.
    """
    known = known or KnownEffects()
    spectra = sorted((s for s in spectra if s.spec.shows_inertia), key=lambda spectrum: spectrum.spec.id)
    if not spectra:
        raise BadInput("estimate", "there is no sweep to identify from")
    check_moved_alone(spectra)
    for spectrum in spectra:
        check_alive(spectrum)
    poses = np.array([spectrum.spec.pose for spectrum in spectra])
    moved = sorted({robot.index(spectrum.spec.axis) for spectrum in spectra})
    chain, unlocked = moving_chain(robot, moved, poses)
    nominal = inertial_parameters(robot, chain, unlocked)
    base = base_parameters(chain, tuple(unlocked.index(number) for number in moved))

    axes: list[AxisEstimate] = []
    places: list[Array] = []
    observation: dict[str, Array] = {}
    for number in moved:
        own = [spectrum for spectrum in spectra if robot.index(spectrum.spec.axis) == number]
        joint = robot.joints[number]
        effects = known.of(joint)
        analysis, gain = (analyses or {}).get(joint), (gains or {}).get(joint) or torque_gain(robot, effects)
        inputs = (robot, number, chain, unlocked, nominal, own, analysis, gain, effects)
        axes.append(identify_axis(*inputs))
        places.append(np.array([s.spec.pose for s in own]))
        observation[joint] = base.rows(chain, unlocked.index(number), places[-1][:, list(unlocked)])
    judged = _judge(axes, observation, np.vstack(places))
    information = Information.empty(len(base.columns))
    for axis in judged.axes:
        information = information.add(observation[axis.joint], axis.values, axis.covariance)
    start, rows = base.combination @ nominal, np.vstack(list(observation.values()))
    prior = None
    if earlier is not None:
        earlier.check(
            base.names, {j: float(poses[:, k].mean()) for k, j in enumerate(robot.joints) if k not in unlocked}
        )
        own = linalg.block_diag(*(axis.covariance for axis in judged.axes))
        prior = earlier.compared(rows, np.concatenate([axis.values for axis in judged.axes]), own)
        if prior.used:
            information = information.plus(earlier.information)
    measured = MeasuredInertias(
        values=np.concatenate([axis.values for axis in judged.axes]),
        variance=np.concatenate([np.diag(axis.covariance) for axis in judged.axes]),
        model=rows @ start,
        rows=rows,
    )
    spread = base_spread(robot, chain, unlocked, base.combination, measured)
    return RobotEstimate(
        robot=robot,
        chain=chain,
        unlocked=unlocked,
        poses=poses,
        axes=judged.axes,
        base=base,
        nominal=nominal,
        solution=information.solve(start, spread),
        spread=spread,
        condition_number=condition_number(rows),
        observation=observation,
        chi_squared=judged.chi_squared,
        suspects=judged.suspects,
        extra=judged.extra,
        errors=judged.errors,
        held_out=judged.held_out,
        known=known,
        prior=prior,
    )


def moving_chain(robot: Robot, moved: Sequence[int], poses: Array) -> tuple[Chain, tuple[int, ...]]:
    """The chain without the joints that never moved over `poses` (n, all joints), and the numbers of the remaining
    joints.
    """
    fixed = {
        number: float(poses[:, number].mean())
        for number in range(len(robot.axes))
        if number not in moved and np.ptp(poses[:, number]) < SAME_POSITION
    }
    return lock(robot.chain, fixed), tuple(number for number in range(len(robot.axes)) if number not in fixed)


@dataclass(frozen=True)
class _Judged:
    axes: tuple[AxisEstimate, ...]
    chi_squared: dict[str, tuple[float, float]]
    suspects: tuple[Suspect, ...]
    extra: dict[str, Array]
    errors: dict[str, Array]
    held_out: dict[str, HeldOutPoses]


def _judge(axes: Sequence[AxisEstimate], observation: Mapping[str, Array], poses: Array) -> _Judged:
    """Axes with the covariance that J = W beta leaves them; `poses` (n, all joints) of the axes' sweeps in turn.

    BadInput for an inertia or a variance that is not finite.
    """
    for axis in axes:
        for sweep, variance in zip(axis.sweeps, np.diag(axis.covariance), strict=True):
            if not (np.isfinite(sweep.value) and np.isfinite(variance)):
                raise BadInput(
                    f"sweep {sweep.sweep} of {axis.joint}",
                    f"its inertia {sweep.value:.4g} with variance {variance:.4g} is not a finite number: check its "
                    "recording and the robot file",
                )
    rows = np.vstack([observation[axis.joint] for axis in axes])
    values = np.concatenate([axis.values for axis in axes])
    judged = judge(rows, values, [axis.covariance for axis in axes])
    edges = list(accumulate((len(axis.sweeps) for axis in axes), initial=0))
    members = {axis.joint: np.arange(a, b) for axis, (a, b) in zip(axes, pairwise(edges), strict=True)}
    found = [suspect for axis in axes for suspect in axis.suspects]
    doubt = "" if judged.ended is WeightingEnded.SETTLED else f" ({judged.ended.value})"
    enlarged: list[AxisEstimate] = []
    chi_squared: dict[str, tuple[float, float]] = {}
    for axis in axes:
        own = members[axis.joint]
        squares, freedom = chi_squared[axis.joint] = judged.left_out.chi_squared(own)
        scale = unexplained(squares, freedom)
        covariance = axis.covariance + np.diag(judged.extra[own])
        enlarged.append(axis.with_covariance(covariance * scale))
        for sweep, error, extra in zip(axis.sweeps, judged.errors[own], judged.extra[own], strict=True):
            if extra > 0:
                why = (
                    f"its inertia differs by {abs(error):.1f} standard deviations from that of the other "
                    f"sweeps in its pose{doubt}"
                )
                found.append(Suspect(axis=axis.joint, sweep=sweep.sweep, why=why, weight=float(error**-2)))
    left_out = LeftOut.of(rows, values, [axis.covariance for axis in enlarged])
    error, std = _predicted(left_out, poses)
    held_out = {joint: HeldOutPoses(error[own], std[own]) for joint, own in members.items()}
    extra, errors = ({joint: of[own] for joint, own in members.items()} for of in (judged.extra, judged.errors))
    return _Judged(tuple(enlarged), chi_squared, tuple(found), extra, errors, held_out)


def unexplained(squares: float, freedom: float) -> float:
    """Factor of the covariance of an axis whose chi-squared is beyond chance, else 1."""
    return (
        squares / freedom
        if freedom >= FitLimits.few_freedom and squares > float(chdtri(freedom, FitLimits.chance))
        else 1.0
    )


def _predicted(left_out: LeftOut, poses: Array) -> tuple[Array, Array]:
    """Every sweep predicted from the sweeps of other poses, in up to 10 folds: errors and their std, (n,) each."""
    folds = 10  # parts into which the poses are divided; each is predicted from the others
    places = np.unique(np.round(poses / SAME_POSITION), axis=0, return_inverse=True)[1].ravel()
    error, std = np.zeros(len(poses)), np.full(len(poses), np.inf)
    for fold in range(min(folds, int(places.max()) + 1)):
        members = np.flatnonzero(places % folds == fold)
        predicted = left_out.together(members)
        if predicted is not None:
            error[members], std[members] = predicted[0], np.sqrt(np.diag(predicted[1]))
    return error, std
