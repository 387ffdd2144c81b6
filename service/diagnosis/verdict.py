"""The verdict of a selection: none, named, ambiguous, unknown or untestable, and which other effects are possible."""

from collections.abc import Sequence
from dataclasses import replace
from enum import Enum

import numpy as np

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.fit.cross_products import solve
from service.diagnosis.fit.equations import COLOURED, Equations, Term
from service.diagnosis.fit.gap import noise_floor
from service.diagnosis.fit.search import CERTAIN, CurrentModel, Explanation
from service.diagnosis.fit.select import LARGE, RIVAL, TOLERANCE, Selection, allowed_by_physics, as_weight
from service.diagnosis.sensitivity import grid, left, shows_beside, visible_part
from service.identification.design.diagnosis_sweeps import is_partial
from service.model import Array

AT_FLOOR = 1.5  # times the noise floor
SLOW = 0.1  # of the explained part: possible effect of slow noise in one direction without repeats


class Verdict(Enum):
    """The result of a diagnosis."""

    NONE = "none"  # the residual of the model is noise
    NAMED = "named"
    AMBIGUOUS = "ambiguous"  # several explanations are equally good
    UNKNOWN = "unknown"  # there is a gap that the catalogue does not explain
    UNTESTABLE = "untestable"  # nothing is found, and the sweeps cannot show that nothing is missing


def judge(
    selection: Selection, known: Sequence[str], candidates: Sequence[str], *, at_floor: bool, conclusive: bool
) -> Verdict:
    """The verdict. `at_floor`: whether the residual is only noise; otherwise an effect is missing or wrong.

    `conclusive`: whether there is a noise floor and no effect of weight is untestable. Otherwise a residual in which
    nothing is found does not show that nothing is missing.
    """
    chosen = selection.chosen
    added = [name for name in chosen.names if name not in known]
    doubtful = is_partial(selection.given.tracks.specs) and _doubtful(selection, added)
    if added and not (doubtful or allowed_by_physics(selection.given, chosen)):
        return Verdict.UNKNOWN
    if not at_floor:
        return Verdict.UNKNOWN
    if not added:
        return Verdict.NONE if candidates and conclusive else Verdict.UNTESTABLE
    rivals = any(tie_sets(selection, known, candidates).values())
    return Verdict.AMBIGUOUS if doubtful or rivals else Verdict.NAMED


def of_one_record(given: Equations) -> bool:
    """Whether all evidence is free motion: effects of the position repeat in each period of a record, too, so the noise
    floor from periods is not that of the machine.
    """
    return all(spec.excitation == "trajectory" for spec in given.tracks.specs)


def at_floor(selection: Selection, left: Array) -> bool:
    """Whether the residual (n, rows) is noise, or so little above the noise floor that the simplified columns of the
    effects may have left it.
    """
    given = selection.given
    if excess(given, selection.chosen) <= CERTAIN or _large_laws(selection):
        return True
    if of_one_record(given):
        return selection.unexplained <= max((CATALOGUE[name].rest for name in selection.chosen.names), default=0.0)
    floor = noise_floor(given, left, range(len(left)))
    floor = given.period_noise if floor is None else floor
    allowed = AT_FLOOR * floor if floor is not None else COLOURED * given.sensor_noise
    return float(np.sqrt(np.mean(left[given.tracks.usable] ** 2))) <= allowed


def _large_laws(selection: Selection) -> bool:
    """Whether two effects, each a large part of the excess, leave no more than their simplified laws may. Three can
    imitate others.
    """
    added = selection.chosen.terms[len(selection.rigid.terms) :]
    return (
        len(added) == 2
        and selection.unexplained <= TOLERANCE
        and all(share(selection, term)[0] > LARGE * selection.rigid.cost for term in added)
    )


def _doubtful(selection: Selection, added: Sequence[str]) -> bool:
    """Whether one of several effects explains no more than the simplified columns of another may have left."""
    chosen = selection.chosen
    for term in (term for term in chosen.terms if term.effect in added and len(added) > 1):
        others = [other for other in chosen.terms if other is not term]
        if share(selection, term)[0] < max(CATALOGUE[other.effect].rest for other in others) * selection.rigid.cost:
            return True
    return False


def share(selection: Selection, term: Term) -> tuple[float, float]:
    """Gain of one of the chosen terms, added to the others: cost and Schwarz's criterion."""
    fewer = CurrentModel(selection.given, [other for other in selection.chosen.terms if other is not term]).alone()
    return fewer.cost - selection.chosen.cost, fewer.criterion - selection.chosen.criterion


def without(selection: Selection, effects: Sequence[str]) -> Selection:
    """The selection without these effects."""
    kept = [term for term in selection.chosen.terms if term.effect not in effects]
    return replace(selection, chosen=CurrentModel(selection.given, kept).alone())


def excess(given: Equations, explanation: Explanation) -> float:
    """The repeatable residual in standard deviations of noise; the maximum over the poses."""
    system = given.system_with(explanation.terms)
    values = np.append(solve(system.sum(axis=0), given.precision(explanation.terms))[0], -1.0)
    costs = np.einsum("i,fij,j->f", values, system, values) - given.pairs.alone
    rows = np.array([sum(block.size for block in fold) for fold in given.pairs.blocks])
    single = costs / np.sqrt(2 * np.maximum(rows, 1))
    return float(max(single.max(), costs.sum() / np.sqrt(2 * rows.sum())))


def tie_sets(selection: Selection, known: Sequence[str], candidates: Sequence[str]) -> dict[str, set[str]]:
    """For each named effect, the effects that explain the same."""
    added = [term for term in selection.chosen.terms if term.effect not in known]
    result = {term.effect: set[str]() for term in added}
    for rival in selection.tried:
        replaced = [term.effect for term in added if term not in rival.terms]
        if len(replaced) == 1 and rival.terms[-1].effect not in result and _as_good(selection, added, rival):
            result[replaced[0]].add(rival.terms[-1].effect)
    taken = {*result, *(name for rivals in result.values() for name in rivals)}
    for term in added:
        result[term.effect] |= _indistinguishable(selection, term, [name for name in candidates if name not in taken])
        if as_weight(selection.given, selection.chosen, term):
            result[term.effect].add("gravity_error")
    by_mass = {name for name in candidates if CATALOGUE[name].by_test_mass}
    for name, rivals in result.items():
        if by_mass & {name, *rivals}:
            rivals |= by_mass - {*result}
    return result


def _as_good(selection: Selection, added: Sequence[Term], rival: Explanation) -> bool:
    """Whether an exchange explains as much as the chosen explanation, is not unnecessary and is physically possible."""
    given, chosen = selection.given, selection.chosen
    replaced = [term for term in added if term not in rival.terms]
    exchanged = [CATALOGUE[term.effect] for term in (*replaced, rival.terms[-1])]
    if all(effect.by_load for effect in exchanged) and not any(effect.exact for effect in exchanged):
        # freed directions of the load are no evidence: they cost nothing if they are not needed
        return rival.cost < chosen.cost + RIVAL and allowed_by_physics(given, rival)
    by_load = any(CATALOGUE[term.effect].by_load for term in (*added, rival.terms[-1]))
    limit = RIVAL if by_load else max(RIVAL, TOLERANCE * selection.rigid.cost)
    one_way, partial = given.tracks.one_way, is_partial(given.tracks.specs)
    if one_way and partial:
        limit = max(limit, SLOW * (selection.rigid.cost - chosen.cost))
    as_good = rival.cost < chosen.cost + limit if one_way else rival.criterion <= chosen.criterion + RIVAL
    if not as_good or not allowed_by_physics(given, rival):
        return False
    contained = {simpler for term in added for simpler in CATALOGUE[term.effect].contains}
    if not partial and rival.terms[-1].effect in contained and rival.parameters < chosen.parameters:
        return False  # otherwise it would have been chosen
    needless = rival.parameters > chosen.parameters and chosen.cost - rival.cost < limit
    if partial:  # a richer effect is unnecessary if its additional columns would be visible but are not
        name = rival.terms[-1].effect
        shapes = (Term(name, shape) for shape in grid(given, name))
        needless &= rival.criterion > chosen.criterion and all(shows_beside(given, chosen.terms, t) for t in shapes)
    return not needless


def _freedom(given: Equations, name: str) -> int:
    """Number of parameters of an effect."""
    effect = CATALOGUE[name]
    return (
        len(effect.coefficients(given.tracks))
        + len(effect.shape(given.tracks, given.model))
        + given.rigid.freedom(name)
    )


def _indistinguishable(selection: Selection, term: Term, names: Sequence[str]) -> set[str]:
    """Effects that are equivalent to a named one: each can represent the characteristic columns of the other."""
    given, terms = selection.given, selection.chosen.terms
    one_way = given.tracks.one_way
    explained = max(selection.rigid.cost - selection.chosen.cost, 1.0)
    if CATALOGUE[term.effect].by_load:
        return set()
    others = [other for other in terms if other is not term]
    own = [given.column(term, k) for k in range(given.width(term))]
    result: set[str] = set()
    for name in (name for name in names if not CATALOGUE[name].by_load):
        if not one_way and _freedom(given, name) > _freedom(given, term.effect):
            continue
        if visible_part(given, terms, name) * explained > RIVAL:
            continue
        rival = Term(name, grid(given, name)[0])
        if all(left(given, [*others, rival], column)[0] * explained < RIVAL for column in own):
            result.add(name)
    return result
