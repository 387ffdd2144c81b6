"""What sets of effects cost: shapes scanned over their grids and refined, everything else multiplied once."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.effect import Shape, ShapeParameter
from service.diagnosis.equations import Equations, Term, solve

Array = NDArray[np.float64]

EVALUATIONS = 16  # of one refinement, for each shape parameter
FIRST_STEP = 0.25  # of a shape's logarithm, or of its range


@dataclass(frozen=True)
class Explanation:
    """A set of effects with shapes: its cost, the same by Schwarz's criterion, how many parameters it has."""

    terms: tuple[Term, ...]
    cost: float
    criterion: float
    parameters: int

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(term.effect for term in self.terms)


class Beside:
    """The rigid model and some terms; `explanation` puts one term more beside them."""

    def __init__(self, given: Equations, terms: Sequence[Term]) -> None:
        self._given, self._terms = given, tuple(terms)
        self._fixed = np.concatenate(
            [given.base, *(given.rows(term) for term in terms), given.right[..., None]], axis=-1
        )
        self._products = given.pairs.products(self._fixed)

    def alone(self) -> Explanation:
        """Without any more."""
        return self._judged(self._terms, self._products)

    def explanation(self, term: Term) -> Explanation:
        """With one term more."""
        columns = self._given.rows(term)
        across = self._given.pairs.products(columns, self._fixed)
        within = self._given.pairs.products(columns)
        # the new columns go before the right side, which stays last
        old, new = self._products, across.transpose(0, 2, 1)
        top = np.concatenate([old[:, :-1, :-1], new[:, :-1], old[:, :-1, -1:]], axis=2)
        middle = np.concatenate([across[:, :, :-1], within, across[:, :, -1:]], axis=2)
        bottom = np.concatenate([old[:, -1:, :-1], new[:, -1:], old[:, -1:, -1:]], axis=2)
        return self._judged((*self._terms, term), np.concatenate([top, middle, bottom], axis=1))

    def best(self, name: str) -> Explanation:
        """An effect at the best shape of its grid."""
        shapes = CATALOGUE[name].shape(self._given.tracks, self._given.model)
        return min(
            (self.explanation(Term(name, values)) for values in product(*(shape.grid for shape in shapes))),
            key=lambda one: one.cost,
        )

    def refined(self, start: Explanation) -> Explanation:
        """The last term's shape moved to the least cost."""
        term = start.terms[-1]
        shapes = CATALOGUE[term.effect].shape(self._given.tracks, self._given.model)
        if not shapes:
            return start

        def cost(vector: Array) -> float:
            return self.explanation(Term(term.effect, _from_vector(shapes, vector))).cost

        first = np.array([np.log(x) if s.low > 0 else x for s, x in zip(shapes, term.shape, strict=True)])
        step = [FIRST_STEP * (1.0 if s.low > 0 else s.high - s.low) for s in shapes]
        found = minimize(
            cost,
            first,
            method="Nelder-Mead",
            options={
                "initial_simplex": np.vstack([first, first + np.diag(step)]),
                "maxfev": EVALUATIONS * len(shapes),
                "xatol": 1e-3,
                "fatol": 0.1,
            },
        )
        better = self.explanation(Term(term.effect, _from_vector(shapes, np.asarray(found.x, dtype=float))))
        return better if better.cost < start.cost else start

    def _judged(self, terms: tuple[Term, ...], products: Array) -> Explanation:
        _, cost, rank = solve(self._given.eliminated(products).sum(axis=0), self._given.viscous_precision)
        cost -= float(self._given.pairs.alone.sum())
        parameters = rank + sum(len(term.shape) for term in terms)
        return Explanation(terms, cost, cost + parameters * float(np.log(self._given.pairs.rows)), parameters)


def _from_vector(shapes: Sequence[ShapeParameter], vector: Array) -> Shape:
    return tuple(
        float(np.clip(np.exp(x) if shape.low > 0 else x, shape.low, shape.high))
        for shape, x in zip(shapes, vector.tolist(), strict=True)
    )
