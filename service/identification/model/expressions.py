"""The simplest expression in named quantities that equals a number in each of several cases.

An expression is a factor times the sum or difference of at most three terms, each a product of named quantities. Its
text is empty if it is 1.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SAME = 1e-8  # of the largest term: difference up to which two numbers count as equal
FACTORS = (1.0, -1.0, 2.0, -2.0, 0.5, -0.5)
MOST_FOR_PAIRS, MOST_FOR_TRIPLES = 400, 80  # maximum number of terms, so that the search does not take seconds


@dataclass(frozen=True)
class Term:
    """A product and its value (g,) in each of the cases."""

    text: str
    value: Array


@dataclass(frozen=True)
class Expression:
    """``factor * text``, the factor signed; text may be empty."""

    factor: float
    text: str


def products(quantities: list[Term], count: int, cases: int) -> list[Term]:
    """All products of `count` of the quantities; for 0: the product 1, with empty text."""
    found: list[Term] = []
    for chosen in combinations_with_replacement(quantities, count):
        same = count == 2 and chosen[0] is chosen[1]
        text = f"{chosen[0].text}^2" if same else " ".join(term.text for term in chosen)
        found.append(Term(text, np.prod([term.value for term in chosen], axis=0) * np.ones(cases)))
    return found


def squared_sums(quantities: list[Term]) -> list[Term]:
    """``(a + b)^2`` and ``(a - b)^2`` of all pairs."""
    return [
        Term(f"({first.text} {mark} {second.text})^2", (first.value + sign * second.value) ** 2)
        for first, second in combinations(quantities, 2)
        for sign, mark in ((1, "+"), (-1, "-"))
    ]


def times(first: Term, second: Term) -> Term:
    return Term(" ".join(filter(None, (first.text, second.text))), first.value * second.value)


class Search:
    """Expressions of the given terms, each with value (g,)."""

    def __init__(self, terms: list[Term]) -> None:
        self._texts: list[str] = [term.text or "1" for term in terms]
        self._values = np.array([term.value for term in terms])
        few = len(terms) <= MOST_FOR_PAIRS
        # the two of a pair and the sign of its second
        self._pairs = [(i, j, sign) for i, j in combinations(range(len(terms)), 2) for sign in (1, -1)] if few else []
        index = np.array(self._pairs, dtype=int).reshape(-1, 3)
        self._sums = self._values[index[:, 0]] + index[:, 2, None] * self._values[index[:, 1]]
        self._tolerance = SAME * np.abs(self._values).max(axis=0)

    def simplest(self, value: Array) -> Expression | None:
        """The expression with the fewest terms; None if there is none. `value` (g,)."""
        return next(self._found(value), None)

    def _found(self, value: Array) -> Iterator[Expression]:
        for factor in FACTORS:
            for i in self._equal(self._values, value / factor):
                yield Expression(factor, "" if self._texts[i] == "1" else self._texts[i])
        for factor in FACTORS:
            for pair in self._equal(self._sums, value / factor):
                yield Expression(factor, f"({self._pair(pair)})")
        if len(self._texts) > MOST_FOR_TRIPLES:
            return
        for factor in FACTORS:
            for i, text in enumerate(self._texts):
                for sign, mark in ((1, "+"), (-1, "-")):
                    for pair in self._equal(self._sums, value / factor - sign * self._values[i]):
                        if i not in self._pairs[pair][:2]:
                            yield Expression(factor, f"({self._pair(pair)} {mark} {text})")

    def _equal(self, candidates: Array, value: Array) -> list[int]:
        near = np.flatnonzero(np.abs(candidates[:, 0] - value[0]) <= self._tolerance[0])
        return near[(np.abs(candidates[near] - value) <= self._tolerance).all(axis=1)].tolist()

    def _pair(self, pair: int) -> str:
        i, j, sign = self._pairs[pair]
        return f"{self._texts[i]} {'+' if sign > 0 else '-'} {self._texts[j]}"
