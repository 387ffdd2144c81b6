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

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.fit.cross_products import ORDER, Group, pairing
from service.diagnosis.fit.equations import Equations, Term, remodelled, with_base
from service.diagnosis.fit.gap import over_floor
from service.diagnosis.fit.joint_steps import NEAR_FLOOR, bends, together
from service.diagnosis.fit.parameters import by_name, of_load
from service.diagnosis.fit.search import Beside, Explanation
from service.diagnosis.fit.solving import given_rest, solve

Array = NDArray[np.float64]

CHANCE = 1e-4  # that anything is named where there is nothing
MATERIAL = 0.004  # of the noise variance
SHARE = 0.001  # of the repeatable excess
LARGE = 0.03  # of it
MOSTLY = 0.6  # of what is left
TOLERANCE = 0.001  # of it: a difference that richer physics than the columns' may make
CERTAIN = 6.0  # standard deviations of an excess that chance makes
ROUNDS = 6  # of fitting inertias and shapes in turn
UNCERTAIN = 2.0  # standard deviations by which a parameter of a load may be more than it seems
OF_SPEED = frozenset({"coulomb_friction", "asymmetric_friction", "stribeck_friction", "nonlinear_viscous_friction"})
MOST = 4  # effects at once
RIVAL = 10.0  # of Schwarz's criterion
LOCAL = 0.9  # of the gain in one pose: other poses cannot confirm it, repeats do
RIDGE = 1e-6  # of a column's product
REFINED = 3  # best of the scan whose shapes are refined
NEAR = 0.5  # of the best one's gain, that refining may be worth while


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
    chance = CHANCE / (8 * max(1, len(candidates)))
    chosen, tried = rigid, list[Explanation]()
    for _ in range(MOST):
        if chosen is not rigid and over_floor(given, chosen.terms) < NEAR_FLOOR:
            break  # what is left is little, and its likeliest cause are laws simpler than the world
        table = _table(given, chosen.terms, [c for c in candidates if c not in chosen.names])
        step = _step(given, chosen, table, rigid.cost, chance, first=chosen is rigid)
        if step is None:
            tried = tried or table
            break
        given, chosen = step
        given, chosen = _consistent(given, chosen, len(fixed))
        chosen = _without_needless(given, chosen, rigid.cost, chance, len(fixed))
        tried = _exchanges(given, chosen, candidates, len(fixed))
        if (better := _exchange(given, chosen, tried, rigid.cost, len(fixed))) is not chosen:
            chosen, tried = better, _exchanges(given, better, candidates, len(fixed))
    return Selection(given, chosen, rigid, tuple(tried))


def with_groups(selection: Selection, groups: Sequence[Group]) -> Selection:
    """The same explanation on all sweeps, with the load of the poses that took no part in the naming."""
    given = selection.given
    if len(groups) == len(given.groups):
        return selection
    whole = replace(
        given,
        groups=tuple(groups),
        pairs=pairing(given.tracks.usable, groups, ORDER, 1 + max(group.fold for group in groups)),
    )
    for _ in range(ROUNDS):
        before, whole = whole, remodelled(whole, selection.chosen.terms)
        if whole is before:
            break
    costs = {
        terms: Beside(whole, terms).alone()
        for terms in (selection.chosen.terms, selection.rigid.terms, *(one.terms for one in selection.tried))
    }
    return Selection(
        whole,
        costs[selection.chosen.terms],
        costs[selection.rigid.terms],
        tuple(costs[o.terms] for o in selection.tried),
    )


def settled(selection: Selection, known: Sequence[str]) -> Selection:
    """The same with the shapes that all sweeps say."""
    fixed = sum(term.effect in known for term in selection.chosen.terms)
    if len(selection.chosen.terms) == fixed:
        return selection
    given, chosen = _consistent(selection.given, selection.chosen, fixed)
    return replace(selection, given=given, chosen=chosen)


def held_out(given: Equations, terms: Sequence[Term]) -> Array:
    """Cost of each fold (folds,) with the effects' coefficients from all others; the rigid model is fitted to all.

    With a single fold the fit is on all of it: repeats then hold one another out.
    """
    system, precision = given.system_with(terms), given.precision(terms)
    total = system.sum(axis=0)
    costs: list[float] = []
    for own in system:
        effects = _elsewhere(total, own if len(system) > 1 else 0 * own, precision)[len(precision) :]
        costs.append(_cost(own, np.append(given_rest(total, precision, effects), effects)))
    return np.array(costs)


def allowed_by_physics(given: Equations, explanation: Explanation) -> bool:
    """Whether every effect's parameters are ones that its physics allows."""
    terms = explanation.terms
    values = solve(given.system_with(terms).sum(axis=0), given.precision(terms))[0]
    start, model = given.width_of_base, with_base(given, values[: given.width_of_base]).model
    for term in terms:
        width = given.width(term)
        found = by_name(given, term, values[start : start + width])
        if CATALOGUE[term.effect].by_load:
            told = of_load(given, terms, values, term.effect)
            found = {name: one.value + UNCERTAIN * one.std for name, one in told.items()}
        if not CATALOGUE[term.effect].possible(found, given.tracks, model):
            return False
        start += width
    return True


def local(given: Equations, before: Sequence[Term], after: Sequence[Term]) -> bool:
    """Whether one fold alone shows the difference, so that no other can tell what it should be there."""
    gains = _in_sample(given, before) - _in_sample(given, after)
    return float(gains.max()) > LOCAL * float(np.abs(gains).sum())


def _in_sample(given: Equations, terms: Sequence[Term]) -> Array:
    system = given.system_with(terms)
    values = solve(system.sum(axis=0), given.precision(terms))[0]
    return np.array([_cost(own, values) for own in system])


def _elsewhere(total: Array, own: Array, precision: Array) -> Array:
    """Coefficients without a fold, drawn to zero as far as nothing else tells them."""
    system = total - own
    k = len(system) - 1
    system[range(k), range(k)] += RIDGE * np.abs(np.diag(total)[:k])
    return solve(system, precision)[0]


def _cost(system: Array, values: Array) -> float:
    extended = np.append(values, -1.0)
    return float(extended @ system @ extended)


def _table(given: Equations, terms: Sequence[Term], names: Sequence[str]) -> list[Explanation]:
    """Each candidate beside some terms; those of the scan that may turn out best refined."""
    beside = Beside(given, terms)
    alone = beside.alone()
    scanned = sorted((beside.best(name) for name in names), key=lambda one: one.criterion)
    most = alone.cost - scanned[0].cost if scanned else 0.0
    near = [one for one in scanned[:REFINED] if alone.cost - one.cost > NEAR * most]
    refined = [beside.refined(one) if one in near else one for one in scanned]
    return sorted(refined, key=lambda one: one.criterion)


def _step(
    given: Equations, before: Explanation, table: Sequence[Explanation], excess: float, chance: float, *, first: bool
) -> tuple[Equations, Explanation] | None:
    """The best of a table that enters, on the load that goes with it; one that other poses or physics refuse gives way
    to the next.
    """
    wanted = list(table)
    for _ in range(REFINED):
        step = _simplest(given, wanted, excess)
        if step is None or not _gains(given, before, step, excess, chance, first=first):
            return None
        # columns that are made of the load say what they are only with the load that goes with them
        there, settled = _consistent(given, step, len(before.terms)) if _of_model(step) else (given, step)
        if _holds(given, before, there, settled) and allowed_by_physics(there, settled):
            return there, settled
        wanted.remove(step)
    return None


def _simplest(given: Equations, table: Sequence[Explanation], excess: float) -> Explanation | None:
    """The best, or a simpler one that is as good, of those that physics allows if any. A wrong load has only the prior
    against it, which physics richer than the columns' does not touch.
    """
    if not table:
        return None
    best = table[0]
    if CATALOGUE[best.terms[-1].effect].by_load:
        return best
    near = [one for one in table if one.criterion <= best.criterion + max(0.0, TOLERANCE * excess)]
    if not _leaves(given, best):
        near = [one for one in near if not _leaves(given, one)]
    near = [one for one in near if allowed_by_physics(given, one)] or near
    fewest = min(one.parameters for one in near)
    return next(one for one in near if one.parameters == fewest)


def _leaves(given: Equations, explanation: Explanation) -> bool:
    """Whether an explanation leaves more than chance."""
    return explanation.cost > CERTAIN * float(np.sqrt(2 * given.pairs.rows))


def _gains(
    given: Equations, before: Explanation, after: Explanation, excess: float, chance: float, *, first: bool
) -> bool:
    """Whether an effect more explains enough."""
    gain = before.cost - after.cost
    # what explains the whole rest need not be a large part of the excess
    whole = _leaves(given, before) and not _leaves(given, after)
    limit = float(chi2.isf(chance, max(2, after.parameters - before.parameters)))
    material = 0.0 if CATALOGUE[after.terms[-1].effect].by_load else MATERIAL * given.pairs.rows
    least = max(limit, material, 0.0 if first or whole else SHARE * excess)
    large, mostly = LARGE * excess, MOSTLY * before.cost
    # of two laws of the same speed one is but the other's shape, unless it is large
    alike = after.terms[-1].effect in OF_SPEED and not OF_SPEED.isdisjoint(before.names)
    if not first and gain < (large if alike else min(large, mostly)):
        return False
    return gain >= least and after.criterion < before.criterion


def _holds(given: Equations, before: Explanation, there: Equations, after: Explanation) -> bool:
    """Whether it does so in poses that took no part as well, on the load that goes with it."""
    if CATALOGUE[after.terms[-1].effect].by_load or local(given, before.terms, after.terms):
        return True  # what the prior alone speaks against, no pose can confirm
    return float(held_out(there, after.terms).sum()) < float(held_out(given, before.terms).sum())


def _of_model(explanation: Explanation) -> bool:
    return any(CATALOGUE[term.effect].of_model for term in explanation.terms)


def _consistent(given: Equations, chosen: Explanation, fixed: int) -> tuple[Equations, Explanation]:
    """Load and shapes fitted in turn until neither moves; together where the load is behind a spring."""
    if any(number >= fixed for number in bends(chosen.terms)):
        given, chosen = together(given, chosen)
        if len(chosen.terms) - fixed > 1:
            given, chosen = together(given, _settled(given, chosen, fixed, anew=False))
        return given, chosen
    for count in range(ROUNDS):
        before, given = given, remodelled(given, chosen.terms)
        if given is before:
            break
        chosen = _settled(given, chosen, fixed, anew=count == 0)
    return given, chosen


def _settled(given: Equations, start: Explanation, fixed: int, *, anew: bool) -> Explanation:
    """All shapes refined in turn, as each changes what is best for the others; the last one's found `anew`, for other
    inertias may have moved it far away.
    """
    beside, last = Beside(given, start.terms[:-1]), start.terms[-1]
    result = beside.explanation(last)
    if anew:
        result = min(result, beside.best(last.effect), key=lambda one: one.cost)
    if len(start.terms) - fixed == 1:
        return beside.refined(result)
    for number in range(fixed, len(start.terms)):
        term = result.terms[number]
        others = (*result.terms[:number], *result.terms[number + 1 :])
        beside = Beside(given, others)
        moved = beside.refined(beside.explanation(term))
        result = replace(moved, terms=(*others[:number], moved.terms[-1], *others[number:]))
    return result


def _without_needless(given: Equations, chosen: Explanation, excess: float, chance: float, fixed: int) -> Explanation:
    """Without the terms that the others make superfluous."""
    limit = float(chi2.isf(chance, 2))
    for term in chosen.terms[fixed:-1]:
        fewer = Beside(given, [other for other in chosen.terms if other is not term]).alone()
        needed = _leaves(given, fewer) and not _leaves(given, chosen)
        if fewer.cost - chosen.cost < max(limit, 0.0 if needed else SHARE * excess):
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


def _exchange(
    given: Equations, chosen: Explanation, tried: Sequence[Explanation], excess: float, fixed: int
) -> Explanation:
    """The best exchange of one of several terms, if better than what tolerance allows, or simpler and as good."""
    if len(chosen.terms) - fixed < 2 or not tried:
        return chosen
    tolerance = max(RIVAL, TOLERANCE * excess)
    best = min(tried, key=lambda one: one.criterion)
    if best.criterion < chosen.criterion - tolerance or (_leaves(given, chosen) and not _leaves(given, best)):
        return best
    near = [one for one in tried if one.parameters < chosen.parameters and one.criterion < chosen.criterion + tolerance]
    if not _leaves(given, chosen):
        near = [one for one in near if not _leaves(given, one)]
    return min(near, key=lambda one: (one.parameters, one.criterion), default=chosen)
