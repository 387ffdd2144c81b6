"""The cost of sets of effects: shapes are scanned on grids and refined; all other products are computed once.

The load and the shapes of all chosen effects are fitted together (`together`). If a spring, the load inertia and the
motor inertia, or two laws of the same speed, were fitted in turn, convergence would be very slow, because they are
strongly correlated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.effect import Shape, ShapeParameter
from service.diagnosis.fit.cross_products import Ended, Gathered, solve, symmetric
from service.diagnosis.fit.equations import Equations, Term, joined, remodelled, with_values
from service.model import Array

LONGEST = 0.7  # largest step of the logarithm of a shape parameter
NUDGE = 1e-3  # step for numerical derivatives
WIDTHS = (1.0, 0.3)  # of the step of the grid, for costs that are not smooth
LITTLE = 0.5  # decrease of the cost below which refinement ends
PART = 1e-4  # of the cost: the steps that fit load and shapes end below it as well


@dataclass(frozen=True)
class Explanation:
    """A set of effects with shapes: its cost, the value of Schwarz's criterion, the number of parameters."""

    terms: tuple[Term, ...]
    cost: float
    criterion: float
    parameters: int

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(term.effect for term in self.terms)

    def searched(self, first: int, ended: Ended) -> "Explanation":
        """The same; the search of the shapes from that of term `first` on ended so."""
        terms = [replace(t, ended=ended) if k >= first and t.shape else t for k, t in enumerate(self.terms)]
        return replace(self, terms=tuple(terms))


class CurrentModel:
    """The rigid model and some terms; `explanation` adds one more term."""

    def __init__(self, given: Equations, terms: Sequence[Term]) -> None:
        self._given, self._terms = given, tuple(terms)
        self._products = given.system_with(terms)

    @cached_property
    def _fixed(self) -> Gathered:
        return self._given.together(self._terms)

    def alone(self) -> Explanation:
        """The explanation without a further term."""
        return self._judged(self._terms, self._products)

    def explanation(self, term: Term) -> Explanation:
        """The explanation with one more term."""
        return self._judged((*self._terms, term), self._with(self._given.gathered(term, keep=False)))

    def best(self, name: str) -> Explanation:
        """The explanation with an effect at the best shape of its grid."""
        shapes = CATALOGUE[name].shape(self._given.tracks, self._given.model)
        found = self._at(name, list(product(*(shape.grid for shape in shapes))), keep=True)
        return min(found, key=lambda one: one.cost)

    def _at(self, name: str, shapes: Sequence[Shape], *, keep: bool) -> list[Explanation]:
        columns = self._given.scanned(name, shapes, keep=keep)
        ends = np.cumsum([len(own[0]) for own in columns])[:-1]
        across = np.split(self._across(joined(*columns)), ends, axis=1)  # one product is faster than one for each shape
        return [
            self._judged((*self._terms, Term(name, shape)), self._with(own, products))
            for shape, own, products in zip(shapes, columns, across, strict=True)
        ]

    def refined(self, start: Explanation, steps: int = 4) -> Explanation:
        """The explanation with the shape of the last term optimised; its `Term.ended` says how that ended."""
        effect = CATALOGUE[start.terms[-1].effect]
        shapes = effect.shape(self._given.tracks, self._given.model)
        if not shapes:
            return start
        found, ended = self._stepped(start, shapes, steps) if effect.scan is None else self._rescanned(start, shapes)
        return found.searched(len(found.terms) - 1, ended)

    def _rescanned(self, start: Explanation, shapes: Sequence[ShapeParameter]) -> tuple[Explanation, Ended]:
        """Scan one parameter after the other on finer and finer grids: for costs that are not smooth. UNFINISHED
        if the best point is at an end of the finest grid, but not at a limit of the parameter.
        """
        best, ended = start, Ended.SETTLED
        for width in WIDTHS:
            ended = Ended.SETTLED
            for k, shape in enumerate(shapes):
                at = to_vector(shapes, best.terms[-1].shape)
                grid = to_vector([shape] * len(shape.grid), shape.grid)
                # 0.4 half width if the grid has one point
                reach = width * (float(np.ptp(grid)) / (len(grid) - 1) if len(grid) > 1 else 0.4)
                # 7 grid points within it, on each side
                moved = at + np.linspace(-reach, reach, 7)[:, None] * np.eye(len(at))[k]
                name = best.terms[-1].effect
                found = self._at(name, [from_vector(shapes, vector) for vector in moved], keep=False)
                best = min([best, *found], key=lambda one: one.cost)
                if best in (found[0], found[-1]) and shape.low < best.terms[-1].shape[k] < shape.high:
                    ended = Ended.UNFINISHED
        return best, ended

    def _stepped(self, start: Explanation, shapes: Sequence[ShapeParameter], steps: int) -> tuple[Explanation, Ended]:
        """Gauss-Newton steps, each shortened until the cost decreases."""
        best, name = start, start.terms[-1].effect
        for _ in range(steps):
            at = to_vector(shapes, best.terms[-1].shape)
            step = self._step(best.terms[-1], shapes, at)
            # 3 largest number of times that a step is halved
            for _ in range(3):
                tried = self.explanation(Term(name, from_vector(shapes, at + step)))
                if tried.cost < best.cost:
                    break
                step = step / 3
            else:
                return best, Ended.AT_REST
            gain, best = best.cost - tried.cost, tried
            if gain < LITTLE:
                return best, Ended.SETTLED
        return best, Ended.UNFINISHED

    def _step(self, term: Term, shapes: Sequence[ShapeParameter], at: Array) -> Array:
        """The step of the shape vector `at`, from derivatives fitted together with the columns."""
        own, terms = self._given.gathered(term, keep=False), (*self._terms, term)
        values = self._values(self._with(own), terms)[-len(own[0]) :]
        bent = derivatives(self._given, term, shapes, values)
        extended = tuple(np.concatenate(fold) for fold in zip(own, bent, strict=True))
        return np.clip(self._values(self._with(extended), terms)[-len(at) :], -LONGEST, LONGEST)

    def _across(self, columns: Gathered) -> Array:
        """(folds, k, l) products of columns with the rigid model, the terms and the right side."""
        return self._given.unfolded(self._given.pairs.crossed(columns, self._fixed))

    def _with(self, columns: Gathered, across: Array | None = None) -> Array:
        """Products with columns inserted before the right side, which stays last; `across`: those with all others."""
        across = self._across(columns) if across is None else across
        within = self._given.pairs.crossed(columns, columns)
        old, new = self._products, across.transpose(0, 2, 1)
        top = np.concatenate([old[:, :-1, :-1], new[:, :-1], old[:, :-1, -1:]], axis=2)
        middle = np.concatenate([across[:, :, :-1], within, across[:, :, -1:]], axis=2)
        bottom = np.concatenate([old[:, -1:, :-1], new[:, -1:], old[:, -1:, -1:]], axis=2)
        return np.concatenate([top, middle, bottom], axis=1)

    def _values(self, products: Array, terms: Sequence[Term]) -> Array:
        return solve(symmetric(products).sum(axis=0), self._given.precision(terms))[0]

    def _judged(self, terms: tuple[Term, ...], products: Array) -> Explanation:
        system = symmetric(products).sum(axis=0)
        _, cost, rank = solve(system, self._given.precision(terms))
        whole = float(system[-1, -1])
        if cost < -max(whole, self._given.pairs.rows):
            cost = whole  # of a column that does not repeat: its product with itself is 0 by chance
        cost -= float(self._given.pairs.alone.sum())
        parameters = rank + self._given.freedom(terms)
        return Explanation(terms, cost, cost + parameters * float(np.log(self._given.pairs.rows)), parameters)


def derivatives(given: Equations, term: Term, shapes: Sequence[ShapeParameter], values: Array) -> Gathered:
    """Derivatives of a term's torque, for coefficients `values`, by each entry of its shape vector."""
    own, at = given.gathered(term, keep=False), to_vector(shapes, term.shape)
    limits = to_vector(shapes, [shape.high for shape in shapes])
    parts: list[Gathered] = []
    for nudge in np.diag(np.where(at + NUDGE < limits, NUDGE, -NUDGE)):
        there = given.gathered(Term(term.effect, from_vector(shapes, at + nudge)), keep=False)
        parts.append(tuple(values[None] @ (b - a) / nudge.sum() for a, b in zip(own, there, strict=True)))
    return tuple(np.concatenate(fold) for fold in zip(*parts, strict=True))


def to_vector(shapes: Sequence[ShapeParameter], shape: Sequence[float]) -> Array:
    """Shape vector: logarithms of positive parameters, else the fraction of the range; steps of the order of 1."""
    return np.array([np.log(x) if s.low > 0 else x / (s.high - s.low) for s, x in zip(shapes, shape, strict=True)])


def from_vector(shapes: Sequence[ShapeParameter], vector: Array) -> Shape:
    return tuple(
        float(np.clip(np.exp(x) if s.low > 0 else x * (s.high - s.low), s.low, s.high))
        for s, x in zip(shapes, vector.tolist(), strict=True)
    )


DAMPING = (0.0, 0.03, 0.3, 3.0, 30.0)  # times the diagonal product of a derivative
ELSEWHERE = (0.5, 2.0, 0.25, 4.0)
CERTAIN = 6.0  # standard deviations: above, an excess is significant
NEAR_FLOOR = 1.3  # times the noise floor: below, the fit is good
STEPS = 15


def leaves(given: Equations, explanation: Explanation) -> bool:
    """Whether the residual of an explanation is significant."""
    return explanation.cost > CERTAIN * float(np.sqrt(2 * given.pairs.rows))


def bends(terms: Sequence[Term]) -> list[int]:
    """Indices of the terms that change the effect of the load on the motor."""
    return [k for k, term in enumerate(terms) if CATALOGUE[term.effect].parts is not None]


def together(
    given: Equations, start: Explanation, fixed: int = 0, steps: int = STEPS, *, again: bool = False
) -> tuple[Equations, Explanation]:
    """Minimise the cost over the load and the shapes of the terms from number `fixed` on, together. `Term.ended` of
    these terms says how it ended.

    With a load behind a spring that is too light, the cost may have several minima in stiffness. If the residual is
    significant, the steps did not settle or a shape is at its upper limit, they start again from other stiffnesses (the
    first entry of the shape). `again`: that was done before. With the same columns from the same point, as when ripples
    were added to the robot file and do not matter, the end is known.
    """
    system = given.system_with(start.terms)
    point = (start.terms, fixed, given.coefficients.tobytes(), given.late, steps, again, system.tobytes())
    if point not in given.ends_of_steps:
        given.ends_of_steps[point] = _best(given, start, fixed, steps, again=again)
    there, best = given.ends_of_steps[point]
    return (there if there.tracks is given.tracks else replace(there, tracks=given.tracks)), best


def _best(
    given: Equations, start: Explanation, fixed: int, steps: int, *, again: bool
) -> tuple[Equations, Explanation]:
    # behind a spring the derivatives hold where load and friction are those of the fit: those of CAD may be far
    near = remodelled(given, start.terms) if bends(start.terms) else given
    best = _from(near, start, fixed, steps)
    for number in [number for number in bends(start.terms) if number >= fixed]:
        term = start.terms[number]
        entries = CATALOGUE[term.effect].shape(given.tracks, given.model)
        for factor in () if again else ELSEWHERE:
            found = best[1].terms[number]
            inside = all(value < entry.high for value, entry in zip(found.shape, entries, strict=True))
            if inside and found.ended is not Ended.UNFINISHED and not leaves(*best):
                break
            # 24 noise variances, five times the floor: a stiffness that settled with more is not the cause
            if found.ended is Ended.SETTLED and best[1].cost > 24.0 * given.pairs.rows:
                break
            moved = replace(term, shape=(factor * term.shape[0], *(entry.grid[0] for entry in entries[1:])))
            terms = (*start.terms[:number], moved, *start.terms[number + 1 :])
            other = _from(given, CurrentModel(given, terms).alone(), fixed, steps, below=best[1].cost)
            best = min(best, other, key=lambda found: found[1].cost)
    return best


def _from(
    given: Equations, start: Explanation, fixed: int, steps: int, below: float = np.inf
) -> tuple[Equations, Explanation]:
    """Steps from a point until they gain little; given up if the cost will stay above `below`."""
    given = remodelled(given, start.terms)
    best, ended = CurrentModel(given, start.terms).alone(), Ended.UNFINISHED
    for count in range(1, steps + 1):
        further = _step(given, best, fixed)
        if further is None:
            ended = Ended.AT_REST
            break
        gain = best.cost - further[1].cost
        given, best = further
        if gain < max(LITTLE, PART * best.cost):
            ended = Ended.SETTLED
            break
        # 3.0 of the gains of the steps still left over that of the last one, at most
        if count > steps / 4 and best.cost - 3.0 * gain * (steps - count) > below:
            break
    return given, best.searched(fixed, ended)


def _step(given: Equations, best: Explanation, fixed: int) -> tuple[Equations, Explanation] | None:
    """A Gauss-Newton step, with increasing damping (Levenberg-Marquardt) until the cost decreases; else None."""
    terms, width = best.terms, given.width_of_base
    values = solve(given.system_with(terms).sum(axis=0), given.precision(terms))[0]
    own = np.split(values, np.cumsum([width, *(given.width(term) for term in terms)]))[1:]
    shapes = [
        CATALOGUE[term.effect].shape(given.tracks, given.model)
        if k >= fixed and CATALOGUE[term.effect].scan is None
        else ()
        for k, term in enumerate(terms)
    ]
    bent = [
        derivatives(given, term, entries, coefficients)
        for term, entries, coefficients in zip(terms, shapes, own, strict=False)
        if entries
    ]
    every = [entry for entries in shapes for entry in entries]
    at = to_vector(every, [x for term, entries in zip(terms, shapes, strict=True) for x in term.shape[: len(entries)]])
    low, high = (to_vector(every, [getattr(entry, end) for entry in every]) for end in ("low", "high"))
    system = given.system_with(terms, *bent).sum(axis=0)
    for damping in DAMPING:
        found, step = _solved(system, given.precision(terms), damping, at, low, high)
        left = iter(from_vector(every, at + step))
        moved = tuple(
            replace(term, shape=tuple(next(left) for _ in entries)) if entries else term
            for term, entries in zip(terms, shapes, strict=True)
        )
        tried = with_values(given, moved, found)
        explanation = CurrentModel(tried, moved).alone()
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
