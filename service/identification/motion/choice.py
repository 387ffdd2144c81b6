r"""Friction and the nominal model's weight in the fit of free motions are chosen by held-out parts of them.

All axes are fitted together, each weighted by the size of its residuals. Whitening by the residuals' colour gives up
the low frequencies, where gravity and friction are, for the high ones, where the spring is: it is not used. Friction
beyond Coulomb and viscous (`friction_laws`) takes an error away, or only adds parameters. A nominal model that the data
contradict must weigh less. So these candidates predict parts of the motion that they have not seen, and the one with
the least error is used,

    mean over the axes of log(error / error of the simple estimator) + sum over the axes above 1.05 times it,

where the simple estimator is the same without nominal model: what anybody would try first. It is not a candidate: where
an axis moves alone, or briefly, held-out parts are near the others, and do not show how far its parameters are wrong in
other poses. A nominal model that is worse than its prior says is met by ten times its standard deviations.

Prediction error of a fit of free motions on held-out parts of them.

Each of `FOLDS` parts in turn is left out of all records and predicted from the rest. The noise floor, below which no
model error can fall, is the difference between runs of the same motion, half of its power in each; None if no motion
was run twice.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from service.identification.model import BaseParameters, Information, Scale
from service.identification.motion.equations import AxisEquations, Sampling, all_equations, friction_laws
from service.identification.motion.fit import FOLDS, FreeFit, fit_equations
from service.identification.motion.free_motion import FreeMotion, low_pass
from service.model import Array, Robot


@dataclass(frozen=True)
class HeldOutMotion:
    """RMS of one axis below the band's end, N m (N): `residual` of the fit, `error` of parts held out, `floor`."""

    residual: float
    error: float
    floor: float | None


def held_out(
    records: Sequence[FreeMotion], fit: FreeFit, others: Information, start: Array
) -> dict[str, HeldOutMotion]:
    """By joint. `others`: information without the free motions, including the nominal model's prior."""
    values = fit.information.plus(others).solve(start).values
    return {
        joint: HeldOutMotion(
            residual=_rms([each.values - each.rows @ values for each in _of(fit, joint)], _of(fit, joint)),
            error=error,
            floor=_floor(records, _of(fit, joint), values),
        )
        for joint, error in held_out_errors(fit, others, start).items()
    }


def held_out_errors(fit: FreeFit, others: Information, start: Array) -> dict[str, float]:
    """RMS of what the rest of the records leaves unpredicted in each fold, N m (N), by joint."""
    errors: dict[str, list[Array]] = {}
    for fold in range(FOLDS):
        without = fit.without(fold).plus(others).solve(start).values
        for each, white in zip(fit.equations, fit.white, strict=True):
            out = white.block % FOLDS == fold
            errors.setdefault(each.joint, []).append((each.values - each.rows @ without)[each.sound][out])
    return {joint: float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) for joint, parts in errors.items()}


def _of(fit: FreeFit, joint: str) -> list[AxisEquations]:
    return [each for each in fit.equations if each.joint == joint]


def _rms(signals: Sequence[Array], parts: Sequence[AxisEquations]) -> float:
    kept = np.concatenate([signal[each.sound] for signal, each in zip(signals, parts, strict=True)])
    return float(np.sqrt(np.mean(kept**2)))


def _floor(records: Sequence[FreeMotion], parts: Sequence[AxisEquations], values: Array) -> float | None:
    """Difference between runs of the same motion, minus the modelled effect of the difference of their paths."""
    squares: list[Array] = []
    for one, other in combinations(parts, 2):
        if records[one.record].same_motion(records[other.record]):
            both = one.sound & other.sound
            difference = one.values - other.values - (one.rows - other.rows) @ values
            squares.append(difference[both] ** 2 / 2)
    kept = np.concatenate(squares) if squares else np.zeros(0)
    return float(np.sqrt(np.mean(kept))) if len(kept) else None


SIMPLE = "least squares weighted by axis, Coulomb and viscous friction, no nominal model"
OPEN = 1e4  # times the prior: no nominal model
# of the highest speed, in either direction, at which friction is told
SPEEDS = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.9)


@dataclass(frozen=True)
class IdentifiedFriction:
    """Friction of an axis beyond Coulomb and viscous: `values` (len(LOW_SPEEDS),) N m (N) at `reference` rad/s (m/s).

    `speeds` (m,) and its whole friction there, with Coulomb and viscous, and its standard deviation, (m,).
    """

    reference: float
    values: Array
    speeds: Array
    whole: Array
    std: Array

    def effort(self, velocity: Array) -> Array:
        """(m,) along a motion."""
        return friction_laws(velocity, self.reference) @ self.values


@dataclass(frozen=True)
class Chosen:
    """The best candidate. With any `laws`, by joint, `fit` has room for all axes' behind the r base parameters.

    `others`: information on as many parameters from sweeps, laws and the nominal model, whose prior is `widened`;
    `errors` and `simple`: held-out errors by joint, N m (N), of this and of the simple estimator.
    """

    fit: FreeFit
    others: Information
    start: Array
    widened: float
    laws: frozenset[str]
    errors: dict[str, float]
    simple: dict[str, float]

    @property
    def score(self) -> float:
        ratios = np.array([self.errors[joint] / max(self.simple[joint], 1e-300) for joint in self.simple])
        # worse on an axis than the simple estimator
        return float(np.mean(np.log(ratios)) + np.sum(np.log(np.maximum(ratios / 1.05, 1.0))))

    @property
    def least_errors(self) -> dict[str, float]:
        """By joint, the smaller one of `errors` and `simple`."""
        return {joint: min(error, self.simple[joint]) for joint, error in self.errors.items()}

    def friction(
        self, robot: Robot, base: BaseParameters, more: Information, of: Mapping[str, Scale]
    ) -> dict[str, IdentifiedFriction]:
        """By joint, with `more` information on the parameters; empty without laws."""
        if not self.laws:
            return {}
        count, found = len(robot.axes), self.fit.beside(self.others)[0].plus(self.others).plus(more).solve(self.start)
        laws: dict[str, IdentifiedFriction] = {}
        for joint in sorted(self.laws):
            index, reference = robot.index(joint), of[joint].speed or 1.0
            first = len(base.columns) + index * len(Sampling.low_speeds)
            own = [base.columns.index(part * count + index) for part in (11, 12)]
            own += range(first, first + len(Sampling.low_speeds))
            speeds = reference * np.array([*(-part for part in reversed(SPEEDS)), *SPEEDS])
            further = np.vstack([friction_laws(np.full(2, speed), reference)[:1] for speed in speeds])
            rows = np.column_stack([speeds, np.sign(speeds), further])
            variance = np.einsum("mi,ij,mj->m", rows, found.covariance[np.ix_(own, own)], rows)
            values = found.values[own]
            laws[joint] = IdentifiedFriction(
                reference, values[2:], speeds, rows @ values, np.sqrt(np.maximum(variance, 0.0))
            )
        return laws

    def evidence(self, size: int) -> tuple[Information, Array]:
        """Of the fit beside `others` for the base parameters (size,) alone, whatever the laws are; and its gains."""
        whole, gains = self.fit.beside(self.others)
        found, through = whole.first(size, self.others)
        return found, gains[:size] - through.T @ gains[size:]

    def honest(self, size: int) -> Information:
        """The same from the motions alone."""
        return self.fit.evidence.honest.first(size, self.others)[0]


def scales(records: Sequence[FreeMotion]) -> dict[str, Scale]:
    """By joint, of all that move. RMS of the effort over that of the acceleration is the largest inertia."""
    signals: dict[str, list[Array]] = {}
    for record in records:
        smooth = [low_pass(record.effort, record.rate, record.band)]
        smooth += [low_pass(record.position, record.rate, record.band, order) for order in (1, 2)]
        for k, joint in enumerate(record.joints):
            signals.setdefault(joint, []).append(np.stack(smooth)[:, :, k])
    found: dict[str, Scale] = {}
    for joint, parts in signals.items():
        whole = np.hstack(parts)
        effort, velocity, acceleration = np.sqrt(np.mean(whole**2, axis=1)).tolist()
        if min(effort, velocity, acceleration) > 0:
            found[joint] = Scale(effort / acceleration, effort / velocity, effort, float(np.abs(whole[1]).max()))
    return found


def choose(
    robot: Robot,
    base: BaseParameters,
    records: Sequence[FreeMotion],
    sweeps: Information,
    prior: Information,
    start: Array,
    of: Mapping[str, Scale],
) -> Chosen:
    """The best fit of all records. `sweeps` and `prior`: information on the base parameters (r,) besides them; `of`:
    `scales` of the records.
    """
    parts = all_equations(robot, base, records, {joint: scale.speed or 1.0 for joint, scale in of.items()})
    open_prior = wider(prior, OPEN)
    plain = fit_equations(robot, records, parts, open_prior, start, order=0)
    simple = held_out_errors(plain, open_prior, start)
    efforts = [of.get(joint, Scale()).effort or 1.0 for joint in robot.joints]
    # one sigma of a law's friction is 0.3 of the RMS effort
    law_prior = np.repeat([(0.3 * effort) ** -2 for effort in efforts], len(Sampling.low_speeds))

    def candidate(laws: frozenset[str], widened: float) -> Chosen:
        own, begin, equations = sweeps.plus(wider(prior, widened)), start, parts
        if laws:
            matrix, begin = np.diag(np.append(0 * start, law_prior)), np.append(start, 0 * law_prior)
            own = Information(matrix, 0 * begin).plus(extended(own, len(begin)))
            equations = _with_laws(robot, parts, laws)
        fit = fit_equations(robot, records, equations, own, begin, order=0)
        errors = held_out_errors(fit, own, begin)
        return Chosen(fit, own, begin, widened, laws, errors, simple)

    best = candidate(frozenset(), 1.0)
    everywhere = candidate(frozenset(best.errors), 1.0).errors
    # laws of friction must take three tenths of an axis' error
    better = frozenset(joint for joint, error in everywhere.items() if error < 0.7 * best.errors[joint])
    if better:
        best = min(best, candidate(better, 1.0), key=lambda one: one.score)
    contradicted = contradiction(best.honest(len(start)), prior, start)
    # standard deviations: the prior is too narrow
    if contradicted > 1.5:
        best = min(best, candidate(best.laws, contradicted), key=lambda one: one.score)
    # where the model is worse than its prior says, and beside other errors cannot be seen to contradict
    return min(best, candidate(best.laws, 10.0), key=lambda one: one.score)


def contradiction(data: Information, prior: Information, start: Array) -> float:
    """RMS deviation of the data from a prior about `start` (r,), in its standard deviations, where they show more."""
    factor = np.linalg.cholesky(np.linalg.inv(prior.matrix))
    known, directions = np.linalg.eigh(factor.T @ data.matrix @ factor)
    deviation = directions.T @ factor.T @ (data.vector - data.matrix @ start)
    shown = known > 10.0  # what the data determine
    squares = (deviation[shown] / known[shown]) ** 2 / (1 + 1 / known[shown])
    return float(np.sqrt(np.mean(squares))) if shown.any() else 0.0


def wider(prior: Information, times: float) -> Information:
    """A prior with standard deviations that are larger by a factor."""
    return Information(prior.matrix / times**2, prior.vector / times**2, prior.count)


def extended(information: Information, size: int) -> Information:
    """The same of `size` parameters, of which it has the first."""
    more = size - len(information.vector)
    return Information(np.pad(information.matrix, (0, more)), np.pad(information.vector, (0, more)), information.count)


def _with_laws(robot: Robot, parts: Sequence[AxisEquations], joints: frozenset[str]) -> list[AxisEquations]:
    """Rows (m, r + n len(LOW_SPEEDS)): each of the `joints` has its own laws, the others have none."""
    found: list[AxisEquations] = []
    for each in parts:
        own = np.zeros((len(each.rows), len(robot.axes), len(Sampling.low_speeds)))
        if each.joint in joints:
            own[:, robot.index(each.joint)] = each.lacks[:, : len(Sampling.low_speeds)]
        found.append(replace(each, rows=np.hstack([each.rows, own.reshape(len(own), -1)])))
    return found
