"""A model proven: the twin, fitted to some poses, led along the motion of the others.

The columns of the catalogue are simpler than the simulator's physics. So what they found is but a start; from there
parameters go where the twin leaves least, with the columns as its derivatives (Gauss and Newton), and only as far as it
does leave less. A pose left out keeps its own inertia, which nothing else can tell.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.equations import Equations, Term, solve
from service.diagnosis.fitted import Point, derivatives, folds, of_columns, patches, stepped
from service.diagnosis.gap import RIDGE, splits
from service.diagnosis.grams import ORDER, Group, pairing
from service.diagnosis.links import gravity
from service.diagnosis.patch import Inexpressible
from service.diagnosis.scenario import AxisEntry, axis_entry
from service.diagnosis.signals import laid_out
from service.diagnosis.twin import Run, torques, ways
from service.recording import Sweep

Array = NDArray[np.float64]

ROUNDS = 4  # of Gauss and Newton at most
STUCK = 1e-3  # of what its column says: a parameter that moves nothing
NUDGE = 0.02  # of the largest torque, for differences
BETTER = 0.01  # of what is left: less is no reason to go on
CHANCE = 4.0  # in units of the noise, likewise


@dataclass(frozen=True)
class Simulated:
    """The twin at its best: the model, what it leaves (n, rows) of sweeps that took no part, N m, and its limits.

    `every`: whitened [a, v, derivatives, what is left] (n, rows, k) of it.
    """

    point: Point
    residual: Array
    every: Array
    held: tuple[str, ...]


class Twin:
    """All sweeps of an axis, and what a model needs along their motion."""

    def __init__(self, given: Equations, sweeps: Sequence[Sweep]) -> None:
        self._given, self._tracks = given, given.tracks
        self._ways = ways([s for s in sweeps if s.spec.axis == given.tracks.joint and s.spec.moves])
        self._effort = self._tracks.rows(self._tracks.effort)

    def simulated(self, terms: Sequence[Term], *, by_repeat: bool) -> Simulated:
        """The best model of these terms, proven on poses, or repeats, left out; Inexpressible."""
        best = of_columns(self._given, terms)
        left, slopes = self._left([(best, None)]), derivatives(self._given, best)
        for number in range(ROUNDS):
            if number == 1:
                slopes = self._by_twin(best, left, slopes)
            before = self._cost(left)
            for moved in self._moved(best, left, slopes):
                try:
                    further = self._left([(moved, None)])
                except Inexpressible:
                    continue
                if self._cost(further) < before:
                    best, left = moved, further
                    break
            if before - self._cost(left) < max(BETTER * before, CHANCE):
                break
        held_out = self._held_out(best, left, slopes, by_repeat)
        return Simulated(best, held_out, self._every(slopes, left), self.entry(best).held)

    def entry(self, point: Point) -> AxisEntry:
        """The axis of a model as a scenario has it; Inexpressible."""
        tracks = self._tracks
        typical = float(np.mean(point.inertia))
        return axis_entry(tracks.robot, tracks.joint, typical, point.viscous, patches(self._given, point))

    def _left(self, wanted: Sequence[tuple[Point, Sequence[int] | None]]) -> Array:
        """What models leave of the efforts of sweeps (None: all), rows of all one after the other; Inexpressible."""
        tracks, runs = self._tracks, list[Run]()
        index = tracks.robot.index(tracks.joint)
        for point, chosen in wanted:
            entry = self.entry(point)
            pull = gravity(tracks.robot, entry.links, index, tracks.poses)[tracks.spot]
            numbers = range(len(tracks.specs)) if chosen is None else chosen
            runs += [Run(k, entry, float(point.inertia[k]), (float(pull[k, 0]), float(pull[k, 1]))) for k in numbers]
        needed = torques(tracks.robot, tracks.joint, self._ways, runs)
        return self._effort[[run.sweep for run in runs]] - tracks.rows(laid_out(tracks, needed))

    def _cost(self, left: Array) -> float:
        """Of what is left of all sweeps, inertias and viscous friction free."""
        system = self._given.system_of(self._every(self._given.base[..., :0], left))
        return solve(system, self._given.viscous_precision)[1]

    def _by_twin(self, point: Point, left: Array, alike: Array) -> Array:
        """The same as differences of the twin; `alike`, those of the columns, say how far to go."""
        if not alike.shape[-1]:
            return alike
        values = np.concatenate([*point.coefficients, *(np.array(term.shape) for term in point.terms)])
        strength = np.maximum(np.sqrt(np.mean(alike**2, axis=(0, 1))), 1e-300)
        size = NUDGE * np.max(np.abs(values * strength)) / strength
        size = np.where(values, np.minimum(size, np.abs(values) / 10), size)
        steps: list[float] = np.where(values < 0, -size, size).tolist()
        still = np.zeros_like(point.inertia)
        try:
            moved = [stepped(self._given, point, np.append(0.0, row), still) for row in np.diag(steps)]
            lefts = np.split(self._left([(one, None) for one in moved]), len(moved))
        except Inexpressible:
            return alike
        differences = [self._given.whitening(left - one) / step for one, step in zip(lefts, steps, strict=True)]
        # a parameter at the scenario's limit moves nothing there; its column knows which way is back
        moving = [np.sqrt(np.mean(d**2)) > STUCK * s for d, s in zip(differences, strength, strict=True)]
        chosen = [d if moves else alike[..., k] for k, (d, moves) in enumerate(zip(differences, moving, strict=True))]
        return np.stack(chosen, axis=-1)

    def _moved(self, point: Point, left: Array, slopes: Array) -> list[Point]:
        """Where Gauss and Newton go, with the shapes and without; not where no scenario can follow."""
        products, result = self._given.pairs.products(self._every(slopes, left)), list[Point]()
        for count in sorted({sum(map(len, point.coefficients)), slopes.shape[-1]}, reverse=True):
            kept = [*range(2 + count), -1]
            own = products[:, kept][:, :, kept]
            step = self._step(own)
            moved = stepped(self._given, point, step, self._inertias(own, step)[folds(self._given)])
            if self._expressible(moved):
                result.append(moved)
        return result

    def _held_out(self, point: Point, left: Array, slopes: Array, by_repeat: bool) -> Array:
        """What is left (n, rows) of each sweep by a model that others have made of this one."""
        given, tracks = self._given, self._tracks
        every = self._every(slopes, left)
        whole = self._step(given.pairs.products(every))
        wanted: list[tuple[Point, list[int]]] = []
        alone: list[list[Group]] = []
        for train, test in splits(given.groups, by_repeat=by_repeat):
            products = pairing(tracks.usable, train, ORDER, len(given.inertia_precision)).products(every)
            step = self._step(products) - whole
            if {group.fold for group in train}.isdisjoint(group.fold for group in test):
                products = self._own(every, test)
                alone.append(test)
            moved = stepped(given, point, step, self._inertias(products, step)[folds(given)])
            if not self._expressible(moved):
                moved = replace(point, inertia=moved.inertia)
            wanted.append((moved, [piece.sweep for group in test for piece in group.pieces]))
        result = left.copy()
        result[[k for _, sweeps in wanted for k in sweeps]] = self._left(wanted)
        acceleration = tracks.rows(tracks.acceleration)
        rest = self._every(slopes[..., :0], result)[..., [0, 2]]
        for test in alone:
            change = self._inertias(self._own(rest, test), np.empty(0))
            for piece, fold in ((piece, group.fold) for group in test for piece in group.pieces):
                at = slice(piece.first, piece.first + piece.rows)
                result[piece.sweep, at] -= change[fold] * acceleration[piece.sweep, at]
        return result

    def _every(self, slopes: Array, left: Array) -> Array:
        """Whitened [a, v, derivatives, what is left] (n, rows, k)."""
        return np.concatenate([self._given.base, slopes, self._given.whitening(left)[..., None]], axis=-1)

    def _expressible(self, point: Point) -> bool:
        try:
            self.entry(point)
        except Inexpressible:
            return False
        return True

    def _own(self, columns: Array, groups: Sequence[Group]) -> Array:
        folds = len(self._given.inertia_precision)
        return pairing(self._tracks.usable, groups, ORDER, folds).products(columns)

    def _step(self, products: Array) -> Array:
        """Of all but the inertias, drawn to zero as far as nothing tells it."""
        system = self._given.eliminated(products).sum(axis=0)
        k = len(system) - 1
        system[range(k), range(k)] += RIDGE * np.abs(np.diag(products.sum(axis=0)))[1:-1]
        return solve(system, self._given.viscous_precision)[0]

    def _inertias(self, products: Array, step: Array) -> Array:
        """Changes (folds,) that go with a step."""
        first = products[:, 0]
        return (first[:, -1] - first[:, 1 : 1 + len(step)] @ step) / (first[:, 0] + self._given.inertia_precision)
