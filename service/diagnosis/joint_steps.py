"""Steps of Gauss and Newton for an effect and the load together: behind a spring, either decides what the other is.

Fitted in turn, a spring, the inertia behind it and the motor's before it would creep along the valley of what they have
in common.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.equations import Equations, Term, remodelled, reshaped, solve, symmetric, with_base
from service.diagnosis.gap import over_floor
from service.diagnosis.search import LITTLE, LONGEST, Beside, Explanation, derivatives, from_vector, to_vector

STEPS = 15
HALVINGS = 4
ELSEWHERE = (0.5, 2.0, 0.25, 4.0)
NEAR_FLOOR = 1.3  # times the noise floor


def bends(terms: Sequence[Term]) -> list[int]:
    """Which of some terms change what the load does."""
    return [k for k, term in enumerate(terms) if CATALOGUE[term.effect].parts is not None]


def together(given: Equations, start: Explanation) -> tuple[Equations, Explanation]:
    """Load and shape of the term that changes what the load does, moved together to the least cost.

    A load taken for too light hides how stiff its spring is, so that there may be several valleys: unless what is left
    is the noise, the steps begin anew from springs of other stiffness (the shape's first entry).
    """
    best = _from(given, start)
    for factor in ELSEWHERE:
        if over_floor(best[0], best[1].terms) < NEAR_FLOOR:
            break
        term = start.terms[(number := bends(start.terms)[0])]
        plain = [entry.grid[0] for entry in CATALOGUE[term.effect].shape(given.tracks, given.model)]
        other = replace(term, shape=(factor * term.shape[0], *plain[1:]))
        terms = (*start.terms[:number], other, *start.terms[number + 1 :])
        best = min(best, _from(given, Beside(given, terms).alone()), key=lambda found: found[1].cost)
    return best


def _from(given: Equations, start: Explanation) -> tuple[Equations, Explanation]:
    number = bends(start.terms)[0]
    given = remodelled(given, start.terms)
    best = Beside(given, start.terms).alone()
    for _ in range(STEPS):
        further = _step(given, best, number)
        if further is None:
            break
        gain = best.cost - further[1].cost
        given, best = further
        if gain < LITTLE:
            break
    return given, best


def _step(given: Equations, best: Explanation, number: int) -> tuple[Equations, Explanation] | None:
    """One step, shortened until it gains; None if it does not."""
    term = best.terms[number]
    shapes = CATALOGUE[term.effect].shape(given.tracks, given.model)
    at = to_vector(shapes, term.shape)
    values = solve(given.system_with(best.terms).sum(axis=0), given.precision(best.terms))[0]
    first = given.width_of_base + sum(given.width(other) for other in best.terms[:number])
    bent = derivatives(given, term, shapes, values[first : first + given.width(term)])
    columns = given.together(best.terms[:number] + best.terms[number + 1 :], given.gathered(term, keep=False), bent)
    found = solve(symmetric(given.pairs.crossed(columns, columns)).sum(axis=0), given.precision(best.terms))[0]
    step = np.clip(found[-len(at) :], -LONGEST, LONGEST)
    here, there = given.coefficients, found[: given.width_of_base]
    share = 1.0
    for _ in range(HALVINGS):
        moved = replace(term, shape=from_vector(shapes, at + share * step))
        terms = (*best.terms[:number], moved, *best.terms[number + 1 :])
        tried = reshaped(with_base(given, here + share * (there - here)), terms)
        explanation = Beside(tried, terms).alone()
        if explanation.cost < best.cost:
            return tried, explanation
        share /= 3
    return None
