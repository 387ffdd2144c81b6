r"""How free motions are weighted is chosen by their own held-out parts, beside plain least squares.

No weighting is best for every robot. The colour of the residuals (`noise`) is right if they are noise, and costs an
error of the model twice: it gives up the low frequencies, where gravity and friction are, for the high ones, where the
spring is. Friction beyond Coulomb and viscous (`friction_laws`) takes an error away, or only adds parameters. A
nominal model that the data contradict must weigh less. So every candidate predicts parts of the motion that
it has not seen, and the one with the least error is used,

    mean over the axes of log(error / error of the simple estimator) + sum over the axes above `NOT_WORSE` times it,

where the simple estimator is least squares weighted by axis, with Coulomb and viscous friction and no nominal model:
what anybody would try first. It is itself a candidate, so the result is no worse on these parts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.identification.model.base_parameters import BaseParameters
from service.identification.model.least_squares import Information
from service.identification.model.parameter_prior import Scale
from service.identification.motion.equations import LOW_SPEEDS, AxisEquations, all_equations, friction_laws
from service.identification.motion.fit import FreeFit, fit_equations
from service.identification.motion.free_motion import FreeMotion
from service.identification.motion.held_out import held_out_errors
from service.identification.motion.noise import ORDER
from service.identification.spectra.low_pass import low_pass
from service.model.robot import Robot

Array = NDArray[np.float64]

SIMPLE = "least squares weighted by axis, Coulomb and viscous friction, no nominal model"
OPEN = 1e4  # times the prior: no nominal model
NOT_WORSE = 1.05  # times the error of the simple estimator on an axis
LAW_GAIN = 0.9  # of an axis' error: most that is left with laws of friction
CONTRADICTED = 1.5  # standard deviations of the nominal model, RMS, from which its prior is too narrow
SHOWN = 10.0  # times the information of the prior: what the data determine
SPEEDS = (0.05, 0.1, 0.2, 0.5, 0.9)  # of the highest speed, in either direction, at which friction is told
LAW_PRIOR = 0.3  # of the RMS effort, one sigma of a law's friction


@dataclass(frozen=True)
class FrictionLaw:
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
    coloured: bool
    laws: frozenset[str]
    errors: dict[str, float]
    simple: dict[str, float]

    @property
    def score(self) -> float:
        ratios = np.array([self.errors[joint] / max(self.simple[joint], 1e-300) for joint in self.simple])
        return float(np.mean(np.log(ratios)) + np.sum(np.log(np.maximum(ratios / NOT_WORSE, 1.0))))

    @property
    def least_errors(self) -> dict[str, float]:
        """By joint, the smaller one of `errors` and `simple`."""
        return {joint: min(error, self.simple[joint]) for joint, error in self.errors.items()}

    def friction(
        self, robot: Robot, base: BaseParameters, more: Information, of: Mapping[str, Scale]
    ) -> dict[str, FrictionLaw]:
        """By joint, with `more` information on the parameters; empty without laws."""
        if not self.laws:
            return {}
        count, found = len(robot.axes), self.fit.evidence.honest.plus(self.others).plus(more).solve(self.start)
        laws: dict[str, FrictionLaw] = {}
        for joint in sorted(self.laws):
            index, reference = robot.index(joint), of[joint].speed or 1.0
            first = len(base.columns) + index * len(LOW_SPEEDS)
            own = [base.columns.index(part * count + index) for part in (11, 12)]
            own += range(first, first + len(LOW_SPEEDS))
            speeds = reference * np.array([*(-part for part in reversed(SPEEDS)), *SPEEDS])
            further = np.vstack([friction_laws(np.full(2, speed), reference)[:1] for speed in speeds])
            rows = np.column_stack([speeds, np.sign(speeds), further])
            variance = np.einsum("mi,ij,mj->m", rows, found.covariance[np.ix_(own, own)], rows)
            values = found.values[own]
            laws[joint] = FrictionLaw(reference, values[2:], speeds, rows @ values, np.sqrt(np.maximum(variance, 0.0)))
        return laws

    def evidence(self, size: int) -> tuple[Information, Array]:
        """`honest` and `gain_vector` of the fit for the base parameters (size,) alone, whatever the laws are."""
        whole, gains = self.fit.evidence.honest, self.fit.evidence.gain_vector
        left = whole.matrix[:size, size:]
        through = np.linalg.solve(whole.matrix[size:, size:] + self.others.matrix[size:, size:], left.T)
        vector = gains[:size] - through.T @ gains[size:]
        return Information(whole.matrix[:size, :size] - left @ through, vector.sum(axis=1), whole.count), vector


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
    law_prior = np.repeat([(LAW_PRIOR * effort) ** -2 for effort in efforts], len(LOW_SPEEDS))

    def candidate(order: int, laws: frozenset[str], widened: float) -> Chosen:
        own, begin, equations = sweeps.plus(wider(prior, widened)), start, parts
        if laws:
            matrix, begin = np.diag(np.append(0 * start, law_prior)), np.append(start, 0 * law_prior)
            own = Information(matrix, 0 * begin).plus(extended(own, len(begin)))
            equations = _with_laws(robot, parts, laws)
        fit = fit_equations(robot, records, equations, own, begin, order)
        errors = held_out_errors(fit, own, begin)
        return Chosen(fit, own, begin, widened, order > 0, laws, errors, simple)

    best = min((candidate(order, frozenset(), 1.0) for order in (0, ORDER)), key=lambda one: one.score)
    order = ORDER if best.coloured else 0
    everywhere = candidate(order, frozenset(best.errors), 1.0).errors
    better = frozenset(joint for joint, error in everywhere.items() if error < LAW_GAIN * best.errors[joint])
    if better:
        best = min(best, candidate(order, better, 1.0), key=lambda one: one.score)
    others = [candidate(0, frozenset(), OPEN)]
    contradicted = contradiction(best.evidence(len(start))[0], prior, start)
    if contradicted > CONTRADICTED:
        others.append(candidate(order, best.laws, contradicted))
    return min(best, *others, key=lambda one: one.score)


def contradiction(data: Information, prior: Information, start: Array) -> float:
    """RMS deviation of the data from a prior about `start` (r,), in its standard deviations, where they show more."""
    factor = np.linalg.cholesky(np.linalg.inv(prior.matrix))
    known, directions = np.linalg.eigh(factor.T @ data.matrix @ factor)
    deviation = directions.T @ factor.T @ (data.vector - data.matrix @ start)
    shown = known > SHOWN
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
        own = np.zeros((len(each.rows), len(robot.axes), len(LOW_SPEEDS)))
        if each.joint in joints:
            own[:, robot.index(each.joint)] = each.lacks[:, : len(LOW_SPEEDS)]
        found.append(replace(each, rows=np.hstack([each.rows, own.reshape(len(own), -1)])))
    return found
