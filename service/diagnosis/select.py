r"""Which effects explain what the rigid model leaves: forward steps, swaps and drops, and a test on unseen poses.

Costs are cross-repeat sums of squares in units of the noise: the gain of a column that explains nothing is chi-squared
with one degree of freedom, and  cost + k ln n  is Schwarz's criterion. An effect enters only if its gain

- is beyond chance over all candidates and shapes (`CHANCE`, family-wise),
- is material: `MATERIAL` of the noise power and, after the first, `SHARE` of what the rigid model left, and unless it
  is `LARGE` also most of what is still left: columns that cannot follow the richer physics of the effect before leave a
  rest of which others explain a part each, while a second effect explains nearly all of it,
- holds in poses that took no part in the fit.

Of explanations that cost the same within `TOLERANCE` the simplest is taken.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from service.diagnosis.equations import Equations, Term, remodelled, solve
from service.diagnosis.search import Beside, Explanation

Array = NDArray[np.float64]

CHANCE = 1e-4  # that anything is named where there is nothing
MATERIAL = 0.004  # of the noise variance
SHARE = 0.001  # of the repeatable excess
LARGE = 0.03  # of it
MOSTLY = 0.6  # of what is left
TOLERANCE = 0.001  # of it: a difference that richer physics than the columns' may make
ROUNDS = 2  # of fitting inertias and shapes in turn
MOST = 4  # effects at once
RIVAL = 10.0  # of Schwarz's criterion
LOCAL = 0.9  # of the gain in one pose: other poses cannot confirm it, repeats do
RIDGE = 1e-6  # of a column's product
REFINED = 3  # best of the scan whose shapes are refined


@dataclass(frozen=True)
class Selection:
    """What was chosen, on which equations, what the rigid model costs, and what else was tried beside the rest."""

    given: Equations
    chosen: Explanation
    rigid: Explanation
    tried: tuple[Explanation, ...]  # one term exchanged

    @property
    def unexplained(self) -> float:
        """Part of the repeatable excess that is left."""
        return max(self.chosen.cost, 0.0) / max(self.rigid.cost, 1e-300)


def select(given: Equations, known: Sequence[str], candidates: Sequence[str]) -> Selection:
    """The explanation of an axis: `known` effects belong to the base, `candidates` may be added."""
    fixed: tuple[Term, ...] = ()
    for name in known:
        beside = Beside(given, fixed)
        fixed = beside.refined(beside.best(name)).terms
    if fixed:
        given = remodelled(given, fixed)
    rigid = Beside(given, fixed).alone()
    limit = float(chi2.isf(CHANCE / (8 * len(candidates)), 2))
    chosen, table = rigid, ()
    while len(chosen.terms) - len(fixed) < MOST:
        table = _table(given, chosen.terms, [c for c in candidates if c not in chosen.names])
        step = _simplest(table, rigid.cost)
        if step is None or not _enters(given, chosen, step, rigid.cost, limit, first=chosen is rigid):
            break
        chosen = step
        for _ in range(ROUNDS):
            given = remodelled(given, chosen.terms)
            chosen = _settled(given, chosen, len(fixed))
        chosen = _without_needless(given, chosen, rigid.cost, limit, len(fixed))
        chosen = _exchanged(given, chosen, candidates, rigid.cost, len(fixed))
    tried = table if chosen is rigid else _exchanges(given, chosen, candidates, len(fixed))
    return Selection(given, chosen, rigid, tuple(tried))


def held_out(given: Equations, terms: Sequence[Term]) -> Array:
    """Cost of each fold (folds,) with coefficients from all others; its own inertia is fitted where it is.

    With a single fold the fit is on all of it: repeats then hold one another out.
    """
    columns = [given.rows(term) for term in terms]
    system = given.system(np.concatenate(columns, axis=-1) if columns else None)
    total = system.sum(axis=0)
    return np.array([_cost(own, _elsewhere(given, total, own if len(system) > 1 else 0 * own)) for own in system])


def local(given: Equations, before: Sequence[Term], after: Sequence[Term]) -> bool:
    """Whether one fold alone shows the difference, so that no other can tell what it should be there."""
    gains = _in_sample(given, before) - _in_sample(given, after)
    return float(gains.max()) > LOCAL * float(np.abs(gains).sum())


def _in_sample(given: Equations, terms: Sequence[Term]) -> Array:
    columns = [given.rows(term) for term in terms]
    system = given.system(np.concatenate(columns, axis=-1) if columns else None)
    values = solve(system.sum(axis=0), given.viscous_precision)[0]
    return np.array([_cost(own, values) for own in system])


def _elsewhere(given: Equations, total: Array, own: Array) -> Array:
    """Coefficients without a fold, drawn to zero as far as nothing else tells them."""
    system = total - own
    k = len(system) - 1
    system[range(k), range(k)] += RIDGE * np.abs(np.diag(total)[:k])
    return solve(system, given.viscous_precision)[0]


def _cost(system: Array, values: Array) -> float:
    extended = np.append(values, -1.0)
    return float(extended @ system @ extended)


def _table(given: Equations, terms: Sequence[Term], names: Sequence[str]) -> tuple[Explanation, ...]:
    """Each candidate beside some terms; the best of the scan refined."""
    beside = Beside(given, terms)
    scanned = sorted((beside.best(name) for name in names), key=lambda one: one.criterion)
    return tuple(sorted([*map(beside.refined, scanned[:REFINED]), *scanned[REFINED:]], key=lambda one: one.criterion))


def _simplest(table: Sequence[Explanation], excess: float) -> Explanation | None:
    """The best, or a simpler one that is as good."""
    if not table:
        return None
    best = table[0]
    near = [one for one in table if one.criterion <= best.criterion + max(0.0, TOLERANCE * excess)]
    fewest = min(one.parameters for one in near)
    return next(one for one in near if one.parameters == fewest)


def _enters(
    given: Equations, before: Explanation, after: Explanation, excess: float, limit: float, *, first: bool
) -> bool:
    gain = before.cost - after.cost
    least = max(limit, MATERIAL * given.pairs.rows, 0.0 if first else SHARE * excess)
    if not first and gain < min(LARGE * excess, MOSTLY * before.cost):
        return False
    if gain < least or after.criterion >= before.criterion:
        return False
    if local(given, before.terms, after.terms):
        return True
    return float(held_out(given, after.terms).sum()) < float(held_out(given, before.terms).sum())


def _settled(given: Equations, start: Explanation, fixed: int) -> Explanation:
    """All shapes refined in turn, as each changes what is best for the others."""
    result = Beside(given, start.terms[:-1]).explanation(start.terms[-1])
    if len(start.terms) - fixed == 1:
        return Beside(given, start.terms[:-1]).refined(result)
    for number in range(fixed, len(start.terms)):
        term = result.terms[number]
        others = (*result.terms[:number], *result.terms[number + 1 :])
        beside = Beside(given, others)
        moved = beside.refined(beside.explanation(term))
        result = replace(moved, terms=(*others[:number], moved.terms[-1], *others[number:]))
    return result


def _without_needless(given: Equations, chosen: Explanation, excess: float, limit: float, fixed: int) -> Explanation:
    """Without the terms that the others make superfluous."""
    for term in chosen.terms[fixed:-1]:
        fewer = Beside(given, [other for other in chosen.terms if other is not term]).alone()
        if fewer.cost - chosen.cost < max(limit, SHARE * excess):
            chosen = fewer
    return chosen


def _exchanges(given: Equations, chosen: Explanation, candidates: Sequence[str], fixed: int) -> list[Explanation]:
    """Each added term exchanged for each other candidate."""
    result: list[Explanation] = []
    for term in chosen.terms[fixed:]:
        others = [other for other in chosen.terms if other is not term]
        names = [c for c in candidates if c not in {other.effect for other in others}]
        result.extend(one for one in _table(given, others, names) if one.terms[-1].effect != term.effect)
    return result


def _exchanged(
    given: Equations, chosen: Explanation, candidates: Sequence[str], excess: float, fixed: int
) -> Explanation:
    """The best exchange of an earlier term, if better than what tolerance allows."""
    if len(chosen.terms) - fixed < 2:
        return chosen
    best = min(_exchanges(given, chosen, candidates, fixed), key=lambda one: one.criterion)
    return best if best.criterion < chosen.criterion - max(RIVAL, TOLERANCE * excess) else chosen
