"""The difference between model and measurement, in N m (N), on sweeps that were not used in the fit.

Cross-validation: one pose after the other is left out, or with a single pose one repeat after the other. The
coefficients of the effects are fitted to the others. The rigid model, before and after, is fitted to all sweeps,
because only the left-out pose itself determines its inertia.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from service.diagnosis.fit.cross_products import ORDER, Group, given_rest, pairing, solve, symmetric
from service.diagnosis.fit.equations import Equations, Term, reshaped
from service.model import Array
from service.model.results.diagnosis import Gap, PoseGap


def gap(given: Equations, before: Array, after: Array, unseen: Sequence[int], twin_rms: float | None = None) -> Gap:
    """The gap of residuals (n, rows) before and after. `unseen`: sweeps that were not used to select effects; without
    any, the gap is that of all sweeps, each with a fit to the others as far as there are any.
    """
    tracks = given.tracks
    every = np.arange(len(tracks.specs))
    judged = np.array(unseen, dtype=int) if unseen else every
    counted = np.zeros_like(tracks.usable)
    counted[judged] = tracks.usable[judged]
    poses: list[PoseGap] = []
    for pose_index, pose in enumerate(tracks.poses):
        here = every[tracks.pose_index == pose_index]
        usable = tracks.usable[here]
        if usable.any():
            poses.append(
                PoseGap(
                    pose=tuple(pose.tolist()),
                    before_rms=_rms(before[here][usable]),
                    after_rms=_rms(after[here][usable]),
                    noise_floor_rms=noise_floor(given, after, here),
                    sweeps=len(here),
                )
            )
    rms, later, effort = _rms(before[counted]), _rms(after[counted]), _rms(tracks.rows(tracks.effort)[tracks.usable])
    return Gap(
        before_rms=rms,
        after_rms=later,
        noise_floor_rms=noise_floor(given, after, judged.tolist()),
        held_out_sweeps=len(unseen),
        cross_validated=left_out(given),
        source="columns",  # residuals of the model columns: `before_rms` and `after_rms`
        before_percent=100 * rms / effort,
        after_percent=100 * later / effort,
        twin_rms=twin_rms,
        by_pose=tuple(poses),
    )


def improves(given: Equations, before: Array, after: Array) -> bool:
    """Whether the residual decreases significantly with respect to the noise of the same rows."""
    usable = given.tracks.usable
    old, new = before[usable], after[usable]
    # 4 neighbouring rows that count as one independent value, because the filter correlates them
    chance = 2 * noise(given, after) * _rms(old - new) * np.sqrt(4 / len(old))
    return float(np.mean(old**2) - np.mean(new**2)) > 3.0 * chance  # standard deviations


def by_prior(given: Equations, before: Sequence[Term], after: Sequence[Term]) -> bool:
    """Whether added terms are justified mostly by the prior: without it, a load could replace them."""
    costs: list[float] = []
    priors: list[float] = []
    for terms in (before, after):
        precision = given.precision(terms)
        values, cost, _ = solve(given.system_with(terms).sum(axis=0), precision)
        base = values[: len(precision)]
        costs.append(cost)
        priors.append(float(base @ precision @ base))
    return priors[0] - priors[1] > (costs[0] - costs[1]) / 2 > 0


def residual(given: Equations, terms: Sequence[Term], *, by_repeat: bool = False, as_cad: bool = False) -> Array:
    """Filtered residual (n, rows), N m (N), of each sweep: the effects' coefficients are fitted to the other sweeps,
    the rigid model to all. `as_cad`: the load is that of CAD.
    """
    given = reshaped(given, terms)
    tracks, b = given.tracks, given.width_of_base
    precision, system = given.precision(terms), given.system_with(terms)
    total = system.sum(axis=0)
    if as_cad:
        # 1e12 times the product of a column: prior that keeps a coefficient at zero
        precision[range(b - 1), range(b - 1)] += 1e12 * np.abs(np.diag(total)[: b - 1])
    ridge = np.zeros(len(total) - 1)
    # 1e-6 times the product of a column: regularisation of coefficients that the data do not determine
    ridge[b:] = 1e-6 * np.abs(np.diag(total)[b:-1])
    by_repeat = by_repeat or len({group.fold for group in given.groups}) == 1
    whitened = np.concatenate(
        [given.driving, *(np.moveaxis(given.rows(term), -1, 0) for term in terms), given.right[None]]
    )
    columns, result = plain_columns(given, terms), tracks.rows(given.target())
    for train, test in splits(given.groups, by_repeat=by_repeat):
        if by_repeat:
            pairs = pairing(tracks.usable, train, ORDER, given.folds)
            fitted = symmetric(given.crossed(pairs.gathered(whitened), pairs)).sum(axis=0)
        else:
            fitted = system[[fold for fold in range(given.folds) if fold != test[0].fold]].sum(axis=0)
        fitted[range(len(ridge)), range(len(ridge))] += ridge
        effects = solve(fitted, precision)[0][b:]
        values = np.append(given_rest(total, precision, effects), effects)
        for piece in (piece for group in test for piece in group.pieces):
            at = slice(piece.first, piece.first + piece.rows)
            result[piece.sweep, at] -= columns[piece.sweep, at] @ values
    return result


def plain_columns(given: Equations, terms: Sequence[Term]) -> Array:
    """Base columns and columns of terms (n, rows, k), filtered, not whitened, N m (N) for coefficients of one unit."""
    rows = [given.tracks.rows(column) for term in terms for column in given.columns(term)]
    return np.concatenate([given.plain_base, *(row[..., None] for row in rows)], axis=-1)


def over_floor(given: Equations, terms: Sequence[Term]) -> float:
    """RMS of the residual of a fit to all grouped sweeps, over the noise floor; infinite if nothing is repeated."""
    values = solve(given.system_with(terms).sum(axis=0), given.precision(terms))[0]
    left = given.tracks.rows(given.target()) - plain_columns(given, terms) @ values
    grouped = sorted({piece.sweep for group in given.groups for piece in group.pieces})
    floor = noise_floor(given, left, grouped)
    return np.inf if not floor else _rms(left[grouped][given.tracks.usable[grouped]]) / floor


def splits(groups: Sequence[Group], *, by_repeat: bool = False) -> Iterator[tuple[list[Group], list[Group]]]:
    """Fitted groups and left-out groups: by pose, or by repeat if there is one pose."""
    folds = sorted({group.fold for group in groups})
    if len(folds) > 1 and not by_repeat:
        for fold in folds:
            yield [g for g in groups if g.fold != fold], [g for g in groups if g.fold == fold]
        return
    for repeat in range(max(len(group.pieces) for group in groups)):
        train = [replace(g, pieces=g.pieces[:repeat] + g.pieces[repeat + 1 :]) for g in groups]
        test = [replace(g, pieces=g.pieces[repeat : repeat + 1]) for g in groups if repeat < len(g.pieces)]
        yield [g for g in train if g.pieces] or list(groups), test


def left_out(given: Equations) -> bool:
    """Whether cross-validation is possible: not with one pose that was measured without repeats."""
    return given.folds > 1 or any(len(group.pieces) > 1 for group in given.groups)


def noise(given: Equations, left: Array) -> float:
    """RMS of the noise in the residual, N m (N): the noise floor; without repeats the whole residual."""
    floor = noise_floor(given, left, range(len(left)))
    return _rms(left[given.tracks.usable]) if floor is None else floor


def noise_floor(given: Equations, left: Array, sweeps: Iterable[int]) -> float | None:
    """RMS of some sweeps' residual minus its mean over repeats, N m (N); None if none is repeated."""
    squares, rows, own = 0.0, 0.0, np.array(list(sweeps))
    for group in given.groups:
        if group.pieces[0].sweep not in own:
            continue
        parts = np.stack([left[p.sweep, p.first : p.first + p.rows] for p in group.pieces])
        good = np.stack([given.tracks.usable[p.sweep, p.first : p.first + p.rows] for p in group.pieces]).all(axis=0)
        if len(parts) > 1:
            squares += float(np.sum((parts - parts.mean(axis=0))[:, good] ** 2))
            rows += float((len(parts) - 1) * good.sum())
    return float(np.sqrt(squares / rows)) if rows else None


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
