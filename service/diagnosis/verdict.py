"""What a selection amounts to: none, named, ambiguous, unknown or untestable, and who else it might be."""

from collections.abc import Sequence
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.equations import Equations, Term, solve
from service.diagnosis.search import Explanation
from service.diagnosis.select import RIVAL, TOLERANCE, Selection

Array = NDArray[np.float64]

CERTAIN = 6.0  # standard deviations of an excess that chance makes
HIDDEN = 1e-4  # part of a column that a design leaves after rigid model and rivals: less cannot be seen
TESTABLE = 25.0  # chi-squared that an effect of `TYPICAL` size should make
TYPICAL = 0.01  # of the rated effort


class Verdict(Enum):
    """Answer of a diagnosis."""

    NONE = "none"  # the model is as good as the noise allows
    NAMED = "named"
    AMBIGUOUS = "ambiguous"  # several explanations are as good
    UNKNOWN = "unknown"  # there is something, and the catalogue does not explain it
    UNTESTABLE = "untestable"  # the sweeps can show no effect at all


def judge(selection: Selection, known: Sequence[str], candidates: Sequence[str], *, calibrated: bool) -> Verdict:
    """The verdict; `calibrated`: a test mass has fixed the torque gain."""
    chosen = selection.chosen
    added = [name for name in chosen.names if name not in known]
    allowed = max((CATALOGUE[name].rest for name in added), default=0.0)
    left = selection.unexplained > allowed or not plausible(selection)
    if left and excess(selection.given, chosen) > CERTAIN:
        return Verdict.UNKNOWN
    if not added:
        return Verdict.NONE if candidates else Verdict.UNTESTABLE
    return (
        Verdict.AMBIGUOUS
        if tie_set(selection, known, candidates, calibrated=calibrated) != set(added)
        else Verdict.NAMED
    )


def plausible(selection: Selection) -> bool:
    """Whether every effect's first coefficient is one that its physics allows."""
    given, terms = selection.given, selection.chosen.terms
    columns = [given.rows(term) for term in terms]
    system = given.system_of(np.concatenate([given.base, *columns, given.right[..., None]], axis=-1))
    values, start = solve(system, given.viscous_precision)[0], 1
    for term, rows in zip(terms, columns, strict=True):
        low, high = CATALOGUE[term.effect].plausible
        if not low <= values[start] <= high:
            return False
        start += rows.shape[-1]
    return True


def excess(given: Equations, explanation: Explanation) -> float:
    """What an explanation leaves of the repeatable part, in standard deviations of chance; the most of all poses."""
    columns = [given.rows(term) for term in explanation.terms]
    system = given.system(np.concatenate(columns, axis=-1) if columns else None)

    values = np.append(solve(system.sum(axis=0), given.viscous_precision)[0], -1.0)
    costs = np.einsum("i,fij,j->f", values, system, values) - given.pairs.alone
    rows = np.array([sum(block.size for block in fold) for fold in given.pairs.blocks])
    single = costs / np.sqrt(2 * np.maximum(rows, 1))
    return float(max(single.max(), costs.sum() / np.sqrt(2 * rows.sum())))


def tie_set(selection: Selection, known: Sequence[str], candidates: Sequence[str], *, calibrated: bool) -> set[str]:
    """The effects named, and those that explain as much in their place."""
    chosen = selection.chosen
    added = [term for term in chosen.terms if term.effect not in known]
    result = {term.effect for term in added}
    limit = max(RIVAL, TOLERANCE * selection.rigid.cost)
    # in one direction what a richer effect has besides a simpler one can hardly show: it is not needless, but unseen
    one_way = _one_way(selection.given)
    for rival in selection.tried:
        needless = rival.parameters > chosen.parameters and chosen.cost - rival.cost < limit
        as_good = rival.cost < chosen.cost + limit if one_way else rival.criterion <= chosen.criterion + RIVAL
        if as_good and (one_way or not needless):
            result.add(rival.terms[-1].effect)
    if added:
        result |= _indistinguishable(selection, added, [c for c in candidates if c not in result])
    by_mass = {name for name in candidates if CATALOGUE[name].by_test_mass}
    if result & by_mass and not calibrated:
        result |= by_mass
    return result


def _freedom(given: Equations, name: str) -> int:
    """Parameters of an effect."""
    effect = CATALOGUE[name]
    return len(effect.coefficients(given.tracks)) + len(effect.shape(given.tracks, given.model))


def _one_way(given: Equations) -> bool:
    """Whether all that counts was measured in one direction."""
    moving = given.tracks.rows(given.tracks.direction)[given.tracks.usable]
    return not ((moving > 0.5).any() and (moving < -0.5).any())


def _indistinguishable(selection: Selection, added: Sequence[Term], names: Sequence[str]) -> set[str]:
    """Effects that could stand for a named one: what is peculiar to either can be imitated with the other."""
    given, terms = selection.given, selection.chosen.terms
    one_way = _one_way(given)
    explained = max(selection.rigid.cost - selection.chosen.cost, 1.0)
    result: set[str] = set()
    for term in added:
        others = [other for other in terms if other is not term]
        for name in names:
            if not one_way and _freedom(given, name) > _freedom(given, term.effect):
                continue
            if visible_part(given, terms, name) * explained > RIVAL:
                continue
            rival = Term(name, grid(given, name)[0])
            own = np.moveaxis(given.rows(term), -1, 0)
            if all(_left(given, [*others, rival], column)[0] * explained < RIVAL for column in own):
                result.add(name)
    return result


def visible_part(given: Equations, terms: Sequence[Term], name: str) -> float:
    """Of the power of an effect's essential column, what rigid model and terms do not imitate, at its best shape."""
    effect, most = CATALOGUE[name], 0.0
    for shape in grid(given, name):
        own = given.rows(Term(name, shape))[..., effect.essential]
        most = max(most, _left(given, terms, own)[0])
    return most


def untestable(given: Equations, names: Sequence[str]) -> tuple[str, ...]:
    """Effects that would not show at a hundredth of the rated effort, whatever their shape."""
    size = TYPICAL * given.tracks.robot.axis(given.tracks.joint).rated_effort
    result: list[str] = []
    for name in names:
        effect, best = CATALOGUE[name], 0.0
        for shape in grid(given, name):
            column = effect.columns(given.tracks, given.model, shape)[effect.essential]
            peak = float(np.abs(column).max())
            own = given.whitening(given.tracks.rows(column))
            best = max(best, _left(given, (), own)[1] * (size / peak) ** 2 if peak > 0 else 0.0)
        if best < TESTABLE:
            result.append(name)
    return tuple(result)


def grid(given: Equations, name: str) -> list[tuple[float, ...]]:
    """A few shapes of an effect: each parameter at the middle of its grid but the first, which runs over it."""
    shapes = CATALOGUE[name].shape(given.tracks, given.model)
    if not shapes:
        return [()]
    middle = [shape.grid[len(shape.grid) // 2] for shape in shapes[1:]]
    return [(first, *middle) for first in shapes[0].grid[:: max(1, len(shapes[0].grid) // 3)]]


def _left(given: Equations, terms: Sequence[Term], column: Array) -> tuple[float, float]:
    """Part and power of a whitened column (n, rows) that rigid model and terms do not imitate."""
    parts = [given.base, *(given.rows(term) for term in terms), column[..., None]]
    raw = float(np.sum(given.pairs.plain(column[..., None])))
    system = given.system_of(np.concatenate(parts, axis=-1))

    power = solve(system, given.viscous_precision)[1]
    return (power / raw if raw > 0 else 0.0), power
