"""Gauss-Newton steps for an effect and the load together, needed if the load acts through a spring.

If the spring, the load inertia and the motor inertia were fitted in turn, convergence would be very slow, because they
are strongly correlated.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.fit.ended import Ended
from service.diagnosis.fit.equations import Equations, Term, remodelled, reshaped, with_base
from service.diagnosis.fit.gap import over_floor
from service.diagnosis.fit.search import LITTLE, LONGEST, CurrentModel, Explanation, derivatives, from_vector, to_vector
from service.diagnosis.fit.solving import solve

Array = NDArray[np.float64]

STEPS = 15
DAMPING = (0.0, 0.03, 0.3, 3.0, 30.0)  # times the diagonal product of a derivative
ELSEWHERE = (0.5, 2.0, 0.25, 4.0)
NEAR_FLOOR = 1.3  # times the noise floor: below, the fit is good


def bends(terms: Sequence[Term]) -> list[int]:
    """Indices of the terms that change the effect of the load on the motor."""
    return [k for k, term in enumerate(terms) if CATALOGUE[term.effect].parts is not None]


def together(
    given: Equations, start: Explanation, steps: int = STEPS, *, again: bool = False
) -> tuple[Equations, Explanation]:
    """Minimise the cost over the load and the shape of the term that changes its effect, together. `Term.ended` of that
    term says how it ended.

    With a load that is too light, the cost may have several minima in stiffness. Unless the residual is near the noise
    floor, the steps start again from other stiffnesses (the first entry of the shape). `again`: that was done before
    the others were refined, and is only repeated where the first steps do not settle. With the same
    columns from the same point, as when ripples were added to the robot file and do not matter, the end is known.
    """
    system = given.system_with(start.terms)
    point = (start.terms, given.coefficients.tobytes(), given.late, steps, again, system.tobytes())
    if point not in given.ends_of_steps:
        given.ends_of_steps[point] = _best(given, start, steps, again=again)
    there, best = given.ends_of_steps[point]
    return (there if there.tracks is given.tracks else replace(there, tracks=given.tracks)), best


def _best(given: Equations, start: Explanation, steps: int, *, again: bool) -> tuple[Equations, Explanation]:
    best = _from(given, start, steps)
    settled = best[1].terms[bends(start.terms)[0]].ended is Ended.SETTLED
    for factor in () if again and settled else ELSEWHERE:
        if over_floor(best[0], best[1].terms) < NEAR_FLOOR:
            break
        term = start.terms[(number := bends(start.terms)[0])]
        plain = [entry.grid[0] for entry in CATALOGUE[term.effect].shape(given.tracks, given.model)]
        moved = replace(term, shape=(factor * term.shape[0], *plain[1:]))
        terms = (*start.terms[:number], moved, *start.terms[number + 1 :])
        other = _from(given, CurrentModel(given, terms).alone(), steps, below=best[1].cost)
        best = min(best, other, key=lambda found: found[1].cost)
    return best


def _from(given: Equations, start: Explanation, steps: int, below: float = np.inf) -> tuple[Equations, Explanation]:
    """Steps from a point until they gain little; given up if the cost will stay above `below`."""
    number = bends(start.terms)[0]
    given = remodelled(given, start.terms)
    best, ended = CurrentModel(given, start.terms).alone(), Ended.UNFINISHED
    for count in range(1, steps + 1):
        further = _step(given, best, number)
        if further is None:
            ended = Ended.AT_REST
            break
        gain = best.cost - further[1].cost
        given, best = further
        if gain < LITTLE:
            ended = Ended.SETTLED
            break
        # 3.0 of the gains of the steps still left over that of the last one, at most
        if count > steps / 2 and best.cost - 3.0 * gain * (steps - count) > below:
            break
    return given, best.searched(number, ended)


def _step(given: Equations, best: Explanation, number: int) -> tuple[Equations, Explanation] | None:
    """A Gauss-Newton step, with increasing damping (Levenberg-Marquardt) until the cost decreases; else None."""
    term = best.terms[number]
    shapes = CATALOGUE[term.effect].shape(given.tracks, given.model)
    at = to_vector(shapes, term.shape)
    low, high = (to_vector(shapes, [getattr(entry, end) for entry in shapes]) for end in ("low", "high"))
    values = solve(given.system_with(best.terms).sum(axis=0), given.precision(best.terms))[0]
    first = given.width_of_base + sum(given.width(other) for other in best.terms[:number])
    bent = derivatives(given, term, shapes, values[first : first + given.width(term)])
    others = best.terms[:number] + best.terms[number + 1 :]
    system = given.system_with(others, given.gathered(term, keep=False), bent).sum(axis=0)
    for damping in DAMPING:
        found, step = _solved(system, given.precision(best.terms), damping, at, low, high)
        moved = replace(term, shape=from_vector(shapes, at + step))
        terms = (*best.terms[:number], moved, *best.terms[number + 1 :])
        tried = reshaped(with_base(given, found[: given.width_of_base]), terms)
        explanation = CurrentModel(tried, terms).alone()
        if explanation.cost < best.cost:
            return tried, explanation
    return None


def _solved(system: Array, precision: Array, damping: float, at: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Coefficients of all columns but the last ones, and the step of the shape vector `at` in its limits. An entry at
    a limit that would exceed it stays constant, and the others are solved again.
    """
    count, k = len(system) - 1, len(at)
    free = np.ones(k, dtype=bool)
    while True:
        kept = np.append(np.append(np.ones(count - k, dtype=bool), free), True)
        reduced = system[np.ix_(kept, kept)].copy()
        own = np.arange(count - k, len(reduced) - 1)
        reduced[own, own] *= 1 + damping
        found = solve(reduced, precision)[0]
        step = np.zeros(k)
        step[free] = np.clip(found[count - k :], -LONGEST, LONGEST)
        beyond = free & (((at <= low) & (step < 0)) | ((at >= high) & (step > 0)))
        if not beyond.any():
            return found[: count - k], step
        free &= ~beyond
