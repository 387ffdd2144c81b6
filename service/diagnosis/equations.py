r"""The equations of one axis: what the rigid model leaves of the effort, as a sum of columns.

    effort - gravity - J0 a - b0 v = dJ_p a + db v + effects + noise

gravity, J0 and b0 are those of CAD and data sheet; dJ_p belongs to the pose p and db to the axis, both held by their
priors, which enter as pseudo-data. dJ_p is eliminated pose by pose, so a pose can be left out by leaving out its sum.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.effect import Model, Shape
from service.diagnosis.grams import ORDER, Gathered, Group, Pairing, Piece, Whitening, noise_model, pairing
from service.diagnosis.signals import Tracks, white_covariance
from service.identification.regressor import axis_rows
from service.robot import Robot

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SMALLEST = 1e-60  # product of a column that is there
SAME = 1e-3  # a model that moved by less is the same
FLAT = 1e-9  # of a column's own product: below, it is a combination of the others
REPEATED = 0.2  # of the velocity, RMS, by which a repeat may differ


@dataclass(frozen=True)
class Term:
    """An effect of the model with its shape parameters."""

    effect: str
    shape: Shape = ()


@dataclass(frozen=True)
class Equations:
    """Filtered, whitened rows of base columns and right side, and how to add columns to them."""

    tracks: Tracks
    groups: tuple[Group, ...]
    pairs: Pairing
    whitening: Whitening
    model: Model
    base: Array  # (n, rows, 2)
    right: Array  # (n, rows)
    inertia_precision: Array  # (folds,)
    viscous_precision: float
    kept: dict[Term, Gathered] = field(init=False, repr=False, compare=False, default_factory=dict[Term, Gathered])

    def columns(self, term: Term) -> Sequence[Array]:
        """Signals of an effect, (n, t) each."""
        return CATALOGUE[term.effect].columns(self.tracks, self.model, term.shape)

    def rows(self, term: Term) -> Array:
        """The same filtered and whitened, (n, rows, k)."""
        return self._whitened(self.columns(term))

    def _whitened(self, columns: Sequence[Array]) -> Array:
        rows = self.tracks.whitened(np.concatenate(columns), self.whitening.taps)
        return np.moveaxis(rows.reshape(len(columns), -1, rows.shape[1]), 0, -1)

    def _gathered(self, columns: Sequence[Array]) -> Gathered:
        return self.pairs.gathered(self._whitened(columns))

    def gathered(self, term: Term, *, keep: bool = True) -> Gathered:
        """Of these the rows that count; once found, kept."""
        if term in self.kept:
            return self.kept[term]
        found = self._gathered(self.columns(term))
        if keep:
            self.kept[term] = found
        return found

    def scanned(self, name: str, shapes: Sequence[Shape], *, keep: bool = True) -> list[Gathered]:
        """The same of many shapes of an effect."""
        terms = [Term(name, shape) for shape in shapes]
        new = [term for term in terms if term not in self.kept]
        scan = CATALOGUE[name].scan
        if scan is None or not new:
            return [self.gathered(term, keep=keep) for term in terms]
        columns = scan(self.tracks, self.model, [term.shape for term in new])
        found = {term: self._gathered(own) for term, own in zip(new, columns, strict=True)}
        if keep:
            self.kept.update(found)
        return [found.get(term) or self.kept[term] for term in terms]

    def column(self, term: Term, number: int) -> Gathered:
        """One of an effect's columns, gathered."""
        return tuple(fold[number : number + 1] for fold in self.gathered(term))

    def width(self, term: Term) -> int:
        """How many columns an effect has."""
        return len(self.gathered(term)[0])

    @cached_property
    def ends(self) -> tuple[Gathered, Gathered]:
        """The base columns [a, v] and the right side, gathered."""
        return self.pairs.gathered(self.base), self.pairs.gathered(self.right[..., None])

    def together(self, terms: Sequence[Term], *more: Gathered) -> Gathered:
        """Gathered [a, v, terms, more, right side]."""
        base, right = self.ends
        parts = [base, *(self.gathered(term) for term in terms), *more, right]
        return tuple(np.concatenate(fold) for fold in zip(*parts, strict=True))

    def system_with(self, terms: Sequence[Term], *more: Gathered) -> Array:
        """(folds, k, k) products of [v, terms, more, right side], the pose's inertia eliminated."""
        columns = self.together(terms, *more)
        return self.eliminated(self.pairs.crossed(columns, columns))

    def system_against(self, right: Gathered, terms: Sequence[Term]) -> Array:
        """(k, k) products of [v, terms, right], with a right side of its own, summed over folds."""
        parts = [self.ends[0], *(self.gathered(term) for term in terms), right]
        columns = tuple(np.concatenate(fold) for fold in zip(*parts, strict=True))
        return self.eliminated(self.pairs.crossed(columns, columns)).sum(axis=0)

    def system_of(self, columns: Array) -> Array:
        """Products of [v, columns, right side], summed over folds, from whitened [a, v, columns, right side]."""
        return self.eliminated(self.pairs.products(columns)).sum(axis=0)

    def system(self, columns: Array | None = None) -> Array:
        """(folds, k, k) products of [v, columns, right side], the pose's inertia eliminated."""
        parts = [self.base, *([] if columns is None else [columns]), self.right[..., None]]
        return self.eliminated(self.pairs.products(np.concatenate(parts, axis=-1)))

    def eliminated(self, products: Array) -> Array:
        """The same from the products of [a, v, columns, right side]."""
        first = products[:, 0]
        symmetric = (products + products.transpose(0, 2, 1)) / 2
        pivot = first[:, 0] + self.inertia_precision
        return symmetric[:, 1:, 1:] - first[:, 1:, None] * first[:, None, 1:] / pivot[:, None, None]


def solve(system: Array, viscous_precision: float) -> tuple[Array, float, int]:
    """Least squares from a system (k + 1, k + 1) of [v, columns, right side]: coefficients (k,), cost, rank."""
    values, vectors, scale = _scaled(system, viscous_precision)
    right, kept = system[:-1, -1] / scale, values > FLAT
    turned = vectors[:, kept].T @ right
    solution = vectors[:, kept] @ (turned / values[kept])
    return solution / scale, float(system[-1, -1] - right @ solution), int(kept.sum())


def covariance(system: Array, viscous_precision: float) -> Array:
    """Covariance (k, k) of the same; what is not determined is as uncertain as `FLAT` allows."""
    values, vectors, scale = _scaled(system, viscous_precision)
    return (vectors / np.maximum(values, FLAT)) @ vectors.T / np.outer(scale, scale)


def _scaled(system: Array, viscous_precision: float) -> tuple[Array, Array, Array]:
    """Eigenvalues and vectors of the matrix with unit diagonal, and the scale (k,) that made it so."""
    matrix = system[:-1, :-1].copy()
    matrix[0, 0] += viscous_precision
    diagonal = np.diag(matrix)
    # a column that moves nothing has no product, or noise for one
    there = diagonal > SMALLEST
    scale = np.where(there, np.sqrt(np.where(there, diagonal, 1.0)), 1.0)
    matrix = np.where(np.outer(there, there), matrix, 0.0) / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(matrix)
    return values, vectors, scale


def equations(tracks: Tracks, groups: Sequence[Group]) -> Equations:
    """The base model's equations, whitened by what the repeats show."""
    robot, index = tracks.robot, tracks.robot.index(tracks.joint)
    axis, prior = robot.axis(tracks.joint), robot.prior
    nominal = nominal_inertia(robot, index, tracks.poses)
    viscous = axis.viscous_friction or 0.0
    model = Model(nominal[tracks.spot], axis.reflected_motor_inertia or 0.0, viscous)
    rows = [tracks.rows(column) for column in (tracks.acceleration, tracks.velocity)]
    remaining = tracks.rows(nominal_right(tracks))
    alone = white_covariance(tracks.effort, tracks.inside, tracks.rate, ORDER)
    whitening = noise_model(_refitted(tracks, rows, remaining), tracks.usable, groups, alone)
    first_sweep = {group.fold: group.pieces[0].sweep for group in groups}
    typical = np.array([model.inertia[first_sweep[fold]] for fold in range(len(first_sweep))])
    return Equations(
        tracks=tracks,
        groups=tuple(groups),
        pairs=pairing(tracks.usable, groups, ORDER, len(typical)),
        whitening=whitening,
        model=model,
        base=np.stack([whitening(row) for row in rows], axis=-1),
        right=whitening(remaining),
        inertia_precision=(prior.inertia * typical) ** -2.0,
        viscous_precision=(prior.viscous_friction * viscous) ** -2.0 if viscous else 0.0,
    )


def nominal_right(tracks: Tracks) -> Array:
    """What CAD and data sheet leave of the effort, (n, t)."""
    nominal = nominal_inertia(tracks.robot, tracks.robot.index(tracks.joint), tracks.poses)[tracks.spot]
    viscous = tracks.robot.axis(tracks.joint).viscous_friction or 0.0
    return tracks.effort - tracks.gravity - nominal[:, None] * tracks.acceleration - viscous * tracks.velocity


def _refitted(tracks: Tracks, columns: Sequence[Array], right: Array) -> Array:
    """What the best rigid model of each pose leaves of rows (n, rows), noise weighted alike at all frequencies."""
    left = right.copy()
    for spot in range(len(tracks.poses)):
        here = tracks.spot == spot
        good = tracks.usable[here]
        matrix = np.stack([column[here] for column in columns], axis=-1)
        solution = np.linalg.lstsq(matrix[good], right[here][good], rcond=None)[0]
        left[here] -= matrix @ solution
    return left


def nominal_inertia(robot: Robot, index: int, poses: Array) -> Array:
    """Axis inertia (m,) of CAD and data sheet, motor included."""
    motors = [axis.reflected_motor_inertia or 0.0 for axis in robot.axes]
    return axis_rows(robot.chain, index, poses) @ np.concatenate([robot.chain.inertial.ravel(), motors])


def grouped(tracks: Tracks) -> tuple[Group, ...]:
    """Repeats put together: same pose, block and measured motion; a pose is a fold."""
    motion, width = tracks.rows(tracks.velocity), tracks.usable.shape[1]
    collected: list[tuple[int, str, list[int]]] = []
    for number, spec in enumerate(tracks.specs):
        spot = int(tracks.spot[number])
        for other, block, numbers in collected:
            if (other, block) == (spot, spec.block) and _same_motion(motion, tracks.usable, numbers[0], number):
                numbers.append(number)
                break
        else:
            collected.append((spot, spec.block, [number]))
    return tuple(Group(tuple(Piece(k, 0, width) for k in numbers), spot) for spot, _, numbers in collected)


def _same_motion(motion: Array, usable: Mask, one: int, other: int) -> bool:
    """Whether two sweeps moved alike where both count: names alone may be missing, or wrong."""
    both = usable[one] & usable[other]
    first, second = motion[one][both], motion[other][both]
    return bool(both.any() and np.sum((first - second) ** 2) < REPEATED**2 * np.sum(first**2))


def remodelled(given: Equations, terms: Sequence[Term]) -> Equations:
    """With the inertias and friction that a fit with these terms finds, of which some columns are made."""
    tracks = given.tracks
    columns = given.together(terms)
    products = given.pairs.crossed(columns, columns)
    values, _, _ = solve(given.eliminated(products).sum(axis=0), given.viscous_precision)
    pivot = products[:, 0, 0] + given.inertia_precision
    change = (products[:, 0, -1] - products[:, 0, 1:-1] @ values) / pivot
    nominal = nominal_inertia(tracks.robot, tracks.robot.index(tracks.joint), tracks.poses)[tracks.spot]
    fold = np.empty(len(tracks.specs), dtype=int)
    for group in given.groups:
        fold[[piece.sweep for piece in group.pieces]] = group.fold
    viscous = (tracks.robot.axis(tracks.joint).viscous_friction or 0.0) + float(values[0])
    inertia = np.maximum(nominal + change[fold], 0.05 * nominal)
    model = replace(given.model, inertia=inertia, viscous=max(viscous, 0.0))
    if _alike(model, given.model):
        return given
    moved = replace(given, model=model)
    moved.kept.update({term: rows for term, rows in given.kept.items() if not CATALOGUE[term.effect].of_model})
    return moved


def _alike(one: Model, other: Model) -> bool:
    inertia = np.allclose(one.inertia, other.inertia, rtol=SAME, atol=0.0)
    return bool(inertia and np.isclose(one.viscous, other.viscous, rtol=SAME, atol=0.0))
