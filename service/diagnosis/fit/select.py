r"""Selection of the effects that explain the residual of the rigid model: forward steps, swaps, drops, held-out test.

Costs are cross-repeat sums of squares in units of the noise variance. Without an effect, a column's gain is chi-squared
with one degree of freedom, and  cost + k ln n  is Schwarz's criterion. An effect is added only if its gain

- is significant over all candidates and shapes (`CHANCE`, family-wise),
- is large enough: `MATERIAL` of the noise power and, after the first effect, `SHARE` of the rigid model's residual.
    If it is not `LARGE`, it must also be most of the present residual. Columns of the previous effect are simplified
    and leave a residual that other effects explain in part; a real second effect explains nearly all of it,
- is confirmed in poses that were not used in the fit.

Of explanations with equal cost within `TOLERANCE` the simplest is chosen.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.fit.cross_products import ORDER, Ended, Group, given_rest, pairing, solve
from service.diagnosis.fit.equations import Equations, Term, remodelled, with_base
from service.diagnosis.fit.fitted import by_name, of_load
from service.diagnosis.fit.gap import over_floor
from service.diagnosis.fit.search import NEAR_FLOOR, STEPS, CurrentModel, Explanation, bends, leaves, together
from service.model import Array

CHANCE = 1e-4  # probability that an effect is named although there is none
MATERIAL = 0.004  # of the noise variance
SHARE = 0.001  # of the repeatable excess
LARGE = 0.03  # of the repeatable excess
TOLERANCE = 0.001  # of the repeatable excess: cost difference that simplified columns may cause
ROUNDS = 6  # of alternating fits of inertias and shapes
OF_SPEED = frozenset({"coulomb_friction", "asymmetric_friction", "stribeck_friction", "nonlinear_viscous_friction"})
RIVAL = 10.0  # difference in Schwarz's criterion
REFINED = 3  # number of best candidates of the scan whose shapes are refined


@dataclass(frozen=True)
class Selection:
    """The chosen explanation, its equations, the cost of the rigid model, and the other explanations tried.

    `ended`: how the fits of load and shapes in turn ended.
    """

    given: Equations
    chosen: Explanation
    rigid: Explanation
    tried: tuple[Explanation, ...]  # one term exchanged
    ended: Ended = Ended.SETTLED

    @property
    def unexplained(self) -> float:
        """Remaining part of the repeatable excess."""
        return max(self.chosen.cost, 0.0) / max(self.rigid.cost, 1e-300)


def select(
    given: Equations,
    known: Sequence[str],
    candidates: Sequence[str],
    with_better: Callable[[Selection], Equations | None] = lambda _: None,
) -> Selection:
    """The explanation of an axis. `known` effects belong to the base; `candidates` may be added. `with_better`: the
    equations to begin again with, once, if others than the given ones suit what was found.
    """
    fixed: tuple[Term, ...] = ()
    for name in known:
        current = CurrentModel(given, fixed)
        fixed = current.refined(current.best(name)).terms
    if fixed:
        given = remodelled(given, fixed)
    rigid = CurrentModel(given, fixed).alone()
    start, table = Selection(given, rigid, rigid, ()), _table(given, fixed, [c for c in candidates if c not in known])
    found = _grown(start, table, candidates)
    if (better := with_better(found)) is not None:
        return select(better, known, candidates)
    if not (_at_floor(found) or found.chosen is rigid or bends(found.chosen.terms)):
        found = _from_another(found, start, table, candidates)
    return replace(found, tried=tuple(table)) if found.chosen is rigid else _compared(found, candidates)


def _compared(found: Selection, candidates: Sequence[str]) -> Selection:
    """The same, with each term exchanged if that has not been tried yet."""
    fixed = len(found.rigid.terms)
    return replace(found, tried=found.tried or tuple(_exchanges(found.given, found.chosen, candidates, fixed)))


def _from_another(
    found: Selection, start: Selection, table: Sequence[Explanation], candidates: Sequence[str]
) -> Selection:
    """The best explanation with another first effect, if one explains everything; else what was found."""
    rigid = start.rigid
    plain = [name for name in candidates if CATALOGUE[name].parts is None]
    others = [one for one in table if one.terms[-1].effect not in found.chosen.names and _is_start(one, rigid, table)]
    # 4 other first effects that are tried if the best one leads to no explanation
    again = [_grown(start, [other], plain) for other in others[:4]]
    again = [one for one in again if _at_floor(one) and allowed_by_physics(one.given, one.chosen)]
    least = min((one.chosen.cost for one in again), default=0.0) + TOLERANCE * rigid.cost
    near = [one for one in again if one.chosen.cost <= least]
    return _compared(min(near, key=lambda one: (one.chosen.parameters, one.chosen.criterion)), plain) if near else found


def _is_start(one: Explanation, rigid: Explanation, table: Sequence[Explanation]) -> bool:
    """Whether an effect may be the first of several: without the others, another one may explain more."""
    effect, most = CATALOGUE[one.terms[-1].effect], max(rigid.cost - other.cost for other in table)
    return not effect.by_load and effect.parts is None and rigid.cost - one.cost > LARGE * most


def _at_floor(selection: Selection) -> bool:
    given, chosen = selection.given, selection.chosen
    return not leaves(given, chosen) or over_floor(given, chosen.terms) < NEAR_FLOOR


def _grown(start: Selection, table: list[Explanation], candidates: Sequence[str]) -> Selection:
    """The rigid model with one effect of the table, then with others as long as they are accepted."""
    given, rigid, fixed = start.given, start.rigid, len(start.rigid.terms)
    chance = CHANCE / (8 * max(1, len(candidates)))
    chosen, tried, ended = rigid, list[Explanation](), Ended.SETTLED
    # 4 largest number of effects
    for _ in range(4):
        if chosen is not rigid:
            if over_floor(given, chosen.terms) < NEAR_FLOOR:
                break  # the small residual is probably due to simplified effects
            table = _table(given, chosen.terms, [c for c in candidates if c not in chosen.names])
        step = _step(given, chosen, table, rigid.cost, chance, fixed)
        if step is None:
            break
        given, chosen, ended = step
        chosen = _without_needless(given, chosen, rigid.cost, chance, fixed)
        # 3 largest number of exchanges, of which each may make another one possible
        for _ in range(3):
            tried = _exchanges(given, chosen, candidates, fixed) if len(chosen.terms) - fixed > 1 else []
            if (better := _exchange(given, chosen, tried, rigid.cost)) is chosen:
                break
            chosen, tried = better, []
    return Selection(given, chosen, rigid, tuple(tried), ended)


def with_groups(selection: Selection, groups: Sequence[Group]) -> Selection:
    """The same explanation on all sweeps, with the load of the poses that were not used to select effects."""
    given = selection.given
    if len(groups) == len(given.groups):
        return selection
    whole = replace(
        given,
        groups=tuple(groups),
        pairs=pairing(given.tracks.usable, groups, ORDER, 1 + max(group.fold for group in groups)),
    )
    ended = Ended.UNFINISHED
    for _ in range(ROUNDS):
        before, whole = whole, remodelled(whole, selection.chosen.terms)
        if whole is before:
            ended = Ended.SETTLED
            break
    costs = {
        terms: CurrentModel(whole, terms).alone()
        for terms in (selection.chosen.terms, selection.rigid.terms, *(one.terms for one in selection.tried))
    }
    return Selection(
        whole,
        costs[selection.chosen.terms],
        costs[selection.rigid.terms],
        tuple(costs[o.terms] for o in selection.tried),
        ended,
    )


def settled(selection: Selection, known: Sequence[str], steps: int = STEPS) -> Selection:
    """The same explanation with the shapes fitted to all sweeps, in at most so many steps."""
    fixed = sum(term.effect in known for term in selection.chosen.terms)
    if len(selection.chosen.terms) == fixed:
        return selection
    given, chosen, ended = _consistent(selection.given, selection.chosen, fixed, steps, again=True)
    return replace(selection, given=given, chosen=chosen, ended=ended)


def held_out(given: Equations, terms: Sequence[Term]) -> Array:
    """Cost of each fold (folds,); the effects' coefficients are fitted to the others, the rigid model to all.

    With a single fold, the fit uses all of it; then the repeats are left out one by one.
    """
    system, precision = given.system_with(terms), given.precision(terms)
    total = system.sum(axis=0)
    costs: list[float] = []
    for own in system:
        effects = _elsewhere(total, own if len(system) > 1 else 0 * own, precision)[len(precision) :]
        costs.append(_cost(own, np.append(given_rest(total, precision, effects), effects)))
    return np.array(costs)


def allowed_by_physics(given: Equations, explanation: Explanation) -> bool:
    """Whether the parameters of all effects are physically possible."""
    terms = explanation.terms
    values = solve(given.system_with(terms).sum(axis=0), given.precision(terms))[0]
    start, model = given.width_of_base, with_base(given, values[: given.width_of_base]).model
    for term in terms:
        width = given.width(term)
        found = by_name(given, term, values[start : start + width])
        if CATALOGUE[term.effect].by_load:
            known = of_load(given, terms, values, term.effect)
            # 2.0 standard deviations by which a parameter of a load may exceed its estimate
            found = {name: one.value + 2.0 * one.std for name, one in known.items()}
        if not CATALOGUE[term.effect].possible(found, given.tracks, model):
            return False
        if term.shape and as_weight(given, explanation, term):
            return False  # a simpler cause is at hand
        start += width
    return True


def as_weight(given: Equations, explanation: Explanation, term: Term) -> bool:
    """Whether a weight in another place explains as much as one of the terms, which may pull like one."""
    shape = CATALOGUE[term.effect].as_weight
    if shape is None:
        return False
    weight = tuple(Term(term.effect, shape) if one is term else one for one in explanation.terms)
    other = CurrentModel(given, weight).alone()
    more = len(term.shape) + given.width(term) - 2  # parameters than cosine and sine
    return other.cost < explanation.cost + RIVAL + more * float(np.log(given.pairs.rows))


def local(given: Equations, before: Sequence[Term], after: Sequence[Term]) -> bool:
    """Whether the difference is visible in one fold alone, so that other folds cannot predict its size."""
    gains = _in_sample(given, before) - _in_sample(given, after)
    # 0.9 of the gain in one pose: other poses cannot confirm it, but repeats can
    return float(gains.max()) > 0.9 * float(np.abs(gains).sum())


def _in_sample(given: Equations, terms: Sequence[Term]) -> Array:
    system = given.system_with(terms)
    values = solve(system.sum(axis=0), given.precision(terms))[0]
    return np.array([_cost(own, values) for own in system])


def _elsewhere(total: Array, own: Array, precision: Array) -> Array:
    """Coefficients without one fold, regularised to zero where the other folds do not determine them."""
    system = total - own
    k = len(system) - 1
    # 1e-6 times the product of a column
    system[range(k), range(k)] += 1e-6 * np.abs(np.diag(total)[:k])
    return solve(system, precision)[0]


def _cost(system: Array, values: Array) -> float:
    extended = np.append(values, -1.0)
    return float(extended @ system @ extended)


def _table(given: Equations, terms: Sequence[Term], names: Sequence[str]) -> list[Explanation]:
    """Each candidate added to some terms, unless its size is known and another; those of the scan that may become the
    best are refined.
    """
    current = CurrentModel(given, terms)
    alone = current.alone()
    scanned = sorted((current.best(name) for name in names), key=lambda one: one.criterion)
    most = alone.cost - scanned[0].cost if scanned else 0.0
    # 0.5 of the best gain: below, a candidate is not refined
    near = [one for one in scanned[:REFINED] if alone.cost - one.cost > 0.5 * most]
    refined = [current.refined(one) if one in near else one for one in scanned]
    possible = [one for one in refined if not CATALOGUE[one.terms[-1].effect].exact or allowed_by_physics(given, one)]
    return sorted(possible, key=lambda one: one.criterion)


def _step(
    given: Equations, before: Explanation, table: Sequence[Explanation], excess: float, chance: float, fixed: int
) -> tuple[Equations, Explanation, Ended] | None:
    """The best candidate of a table that is accepted, with load and shapes fitted for it. If other poses or its physics
    reject it, the next one is tried.
    """
    wanted, first = list(table), len(before.terms) == fixed
    for _ in range(REFINED):
        step = _simplest(given, wanted, excess)
        if step is None:
            return None
        # columns that depend on the load are only correct with the load fitted for them: their gain is judged then
        if not _of_model(step) and not _gains(given, before, step, excess, chance, first=first):
            return None
        there, settled, ended = _consistent(given, step, fixed, again=bool(bends(before.terms)))
        if not _gains(given, before, settled, excess, chance, first=first):
            return None
        if _holds(given, before, there, settled) and allowed_by_physics(there, settled):
            return there, settled, ended
        wanted.remove(step)
    return None


def _simplest(given: Equations, table: Sequence[Explanation], excess: float) -> Explanation | None:
    """The best, or a simpler one that is as good; physically possible ones first. For a wrong load only the prior
    adds cost; simplified columns do not affect that.
    """
    if not table:
        return None
    best = table[0]
    if CATALOGUE[best.terms[-1].effect].by_load:
        return best
    near = [one for one in table if one.criterion <= best.criterion + max(0.0, TOLERANCE * excess)]
    if not leaves(given, best):
        near = [one for one in near if not leaves(given, one)]
    near = [one for one in near if allowed_by_physics(given, one)] or near
    fewest = min(one.parameters for one in near)
    return next(one for one in near if one.parameters == fewest)


def _gains(
    given: Equations, before: Explanation, after: Explanation, excess: float, chance: float, *, first: bool
) -> bool:
    """Whether an additional effect explains enough."""
    gain = before.cost - after.cost
    # an effect that explains the whole residual need not be a large part of the excess
    whole = leaves(given, before) and not leaves(given, after)
    limit = float(chdtri(max(2, after.parameters - before.parameters), chance))
    material = 0.0 if CATALOGUE[after.terms[-1].effect].by_load else MATERIAL * given.pairs.rows
    least = max(limit, material, 0.0 if first or whole else SHARE * excess)
    # 0.6 of the present residual
    large, mostly = LARGE * excess, 0.6 * before.cost
    # two laws of the same speed: one may only correct the shape of the other, unless its gain is large
    alike = after.terms[-1].effect in OF_SPEED and not OF_SPEED.isdisjoint(before.names)
    if not first and gain < (large if alike else min(large, mostly)):
        return False
    return gain >= least and after.criterion < before.criterion


def _holds(given: Equations, before: Explanation, there: Equations, after: Explanation) -> bool:
    """Whether the gain is confirmed in poses that were not used in the fit, with the load fitted for it."""
    if CATALOGUE[after.terms[-1].effect].by_load or local(given, before.terms, after.terms):
        return True  # no pose can confirm a gain that comes from the prior alone
    return float(held_out(there, after.terms).sum()) < float(held_out(given, before.terms).sum())


def _of_model(explanation: Explanation) -> bool:
    return any(CATALOGUE[term.effect].of_model for term in explanation.terms)


def _consistent(
    given: Equations, chosen: Explanation, fixed: int, steps: int = STEPS, *, again: bool = False
) -> tuple[Equations, Explanation, Ended]:
    """Load and shapes fitted together. Other inertias may change the last effect much, so it is scanned again; not
    with a load behind a spring. `again`: see `together`.
    """
    if not any(number >= fixed for number in bends(chosen.terms)):
        before, given = given, remodelled(given, chosen.terms)
        if given is not before and len(chosen.terms) > fixed:
            current, last = CurrentModel(given, chosen.terms[:-1]), chosen.terms[-1]
            anew = min(current.explanation(last), current.best(last.effect), key=lambda one: one.cost)
            chosen = current.refined(anew)
    given, chosen = together(given, chosen, fixed, steps, again=again)
    unfinished = any(term.ended is Ended.UNFINISHED for term in chosen.terms[fixed:])
    return given, chosen, Ended.UNFINISHED if unfinished else Ended.SETTLED


def _without_needless(given: Equations, chosen: Explanation, excess: float, chance: float, fixed: int) -> Explanation:
    """The explanation without terms that the other terms make unnecessary."""
    limit = float(chdtri(2, chance))
    for term in chosen.terms[fixed:-1]:
        fewer = CurrentModel(given, [other for other in chosen.terms if other is not term]).alone()
        needed = leaves(given, fewer) and not leaves(given, chosen)
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


def _exchange(given: Equations, chosen: Explanation, tried: Sequence[Explanation], excess: float) -> Explanation:
    """The best physically possible exchange of one of several terms, if it is better by more than the tolerance, or as
    good and simpler.
    """
    tolerance = max(RIVAL, TOLERANCE * excess)
    near = [one for one in tried if one.criterion < chosen.criterion + tolerance and allowed_by_physics(given, one)]
    best = min(near, key=lambda one: one.criterion, default=chosen)
    if best.criterion < chosen.criterion - tolerance or (leaves(given, chosen) and not leaves(given, best)):
        return best
    near = [one for one in near if one.parameters < chosen.parameters]
    if not leaves(given, chosen):
        near = [one for one in near if not leaves(given, one)]
    return min(near, key=lambda one: (one.parameters, one.criterion), default=chosen)
