"""How far model and measurement are apart, in N m (N), on sweeps that took no part in the fit.

Poses are left out one after the other; where there is one pose, its repeats are. A pose left out keeps its own inertia,
which nothing else can tell; friction and effects come from the others.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.equations import Equations, Term, nominal_right, solve
from service.diagnosis.grams import ORDER, Group, pairing

Array = NDArray[np.float64]

ALIKE = 4  # neighbouring rows share a filter: so many are one independent value
CERTAIN = 3.0  # standard deviations of a gain that is not chance
RIDGE = 1e-6  # of a column's product: what the others do not tell is drawn to zero


@dataclass(frozen=True, slots=True)
class PoseGap:
    """The same of one pose (all joints)."""

    pose: tuple[float, ...]
    before_rms: float
    after_rms: float
    noise_floor_rms: float | None
    sweeps: int


@dataclass(frozen=True, slots=True)
class Gap:
    """RMS of what is left, N m (N): rigid model, with effects, repeats against one another (None: nothing is repeated).

    `held_out_sweeps`: how many took no part in the fit that they judge; 0 where nothing could be left out.
    """

    before_rms: float
    after_rms: float
    noise_floor_rms: float | None
    effort_rms: float
    held_out_sweeps: int
    by_pose: tuple[PoseGap, ...]


def gap(given: Equations, before: Array, after: Array, held_out: int) -> Gap:
    """Of what sweeps leave (n, rows) before and after, so many of them held out."""
    tracks = given.tracks
    every = np.arange(len(tracks.specs))
    poses: list[PoseGap] = []
    for spot, pose in enumerate(tracks.poses):
        here = every[tracks.spot == spot]
        usable = tracks.usable[here]
        if usable.any():
            sizes = (_rms(before[here][usable]), _rms(after[here][usable]), noise_floor(given, after, here))
            poses.append(PoseGap(tuple(pose.tolist()), *sizes, len(here)))
    return Gap(
        before_rms=_rms(before[tracks.usable]),
        after_rms=_rms(after[tracks.usable]),
        noise_floor_rms=noise_floor(given, after, every),
        effort_rms=_rms(tracks.rows(tracks.effort)[tracks.usable]),
        held_out_sweeps=held_out,
        by_pose=tuple(poses),
    )


def improves(given: Equations, before: Array, after: Array) -> bool:
    """Whether less is left after, beyond what the noise of the same rows could make of it."""
    usable = given.tracks.usable
    old, new = before[usable], after[usable]
    chance = 2 * noise(given, after) * _rms(old - new) * np.sqrt(ALIKE / len(old))
    return float(np.mean(old**2) - np.mean(new**2)) > CERTAIN * chance


def residual(given: Equations, terms: Sequence[Term], *, by_repeat: bool = False) -> Array:
    """What each sweep leaves of its effort (n, rows), N m (N), filtered alike, with coefficients from the others."""
    tracks = given.tracks
    whitened = np.concatenate([given.base, *(given.rows(t) for t in terms), given.right[..., None]], axis=-1)
    unfiltered = [tracks.acceleration, tracks.velocity, *(column for t in terms for column in given.columns(t))]
    columns = np.stack([tracks.rows(column) for column in unfiltered], axis=-1)
    right = tracks.rows(nominal_right(tracks))
    result, folds = right.copy(), len(given.inertia_precision)
    for train, test in splits(given.groups, by_repeat=by_repeat):
        products = pairing(tracks.usable, train, ORDER, folds).products(whitened)
        fitted = given.eliminated(products).sum(axis=0)
        ridge = RIDGE * np.abs(np.diag(given.system_of(whitened)))[:-1]
        fitted[range(len(ridge)), range(len(ridge))] += ridge
        values = solve(fitted, given.viscous_precision)[0]
        for group in test:
            own = products[group.fold] if products[group.fold].any() else _own(given, whitened, test, group.fold)
            change = (own[0, -1] - own[0, 1:-1] @ values) / (own[0, 0] + given.inertia_precision[group.fold])
            for piece in group.pieces:
                at = slice(piece.first, piece.first + piece.rows)
                result[piece.sweep, at] -= columns[piece.sweep, at] @ np.concatenate([[change], values])
    return result


def splits(groups: Sequence[Group], *, by_repeat: bool = False) -> Iterator[tuple[list[Group], list[Group]]]:
    """What is fitted and what is left out: pose by pose, or repeat by repeat where there is one pose."""
    folds = sorted({group.fold for group in groups})
    if len(folds) > 1 and not by_repeat:
        for fold in folds:
            yield [g for g in groups if g.fold != fold], [g for g in groups if g.fold == fold]
        return
    for repeat in range(max(len(group.pieces) for group in groups)):
        train = [replace(g, pieces=g.pieces[:repeat] + g.pieces[repeat + 1 :]) for g in groups]
        test = [replace(g, pieces=g.pieces[repeat : repeat + 1]) for g in groups if repeat < len(g.pieces)]
        yield [g for g in train if g.pieces] or list(groups), test


def left_out(given: Equations, *, by_repeat: bool) -> int:
    """How many sweeps take no part in the fit that judges them: none where one pose was measured without repeats."""
    by_pose = len(given.inertia_precision) > 1 and not by_repeat
    return len(given.tracks.specs) if by_pose or any(len(group.pieces) > 1 for group in given.groups) else 0


def noise(given: Equations, left: Array) -> float:
    """RMS that chance makes of what is left, N m (N): the noise floor; where nothing is repeated, all of it."""
    floor = noise_floor(given, left, range(len(left)))
    return _rms(left[given.tracks.usable]) if floor is None else floor


def noise_floor(given: Equations, left: Array, sweeps: Iterable[int]) -> float | None:
    """RMS of what repeats of some sweeps leave of their mean, N m (N); None where none is repeated."""
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


def _own(given: Equations, whitened: Array, groups: Sequence[Group], fold: int) -> Array:
    return pairing(given.tracks.usable, groups, ORDER, fold + 1).products(whitened)[fold]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
