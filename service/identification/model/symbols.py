"""Base parameters as expressions in the robot's dimensions: ``Iyy(link_2) + Jm(joint_2) + m(link_3) l2^2``.

The coefficients of a base parameter are polynomials in the distances between neighbouring joints, and in sine and
cosine of the twist angles of a link. The polynomial is found by search: the combination K is computed for the robot and
for a few robots with different distances and angles, and a coefficient gets the simplest expression that equals it in
every one of them. Therefore two distances of the same length are not confused, and the expression gives the numbers. A
coefficient without such an expression (a skew axis) keeps its decimals.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations, combinations_with_replacement

import numpy as np

from service.identification.model.regressor import parameter_names
from service.model import Array, Chain, Joint, rotation_about


@dataclass(frozen=True)
class Product:
    """A product and its value (g,) in each of the cases."""

    text: str
    value: Array


@dataclass(frozen=True)
class Expression:
    """``factor * text``, the factor signed; text may be empty."""

    factor: float
    text: str


def products(quantities: list[Product], count: int, cases: int) -> list[Product]:
    """All products of `count` of the quantities; for 0: the product 1, with empty text."""
    found: list[Product] = []
    for chosen in combinations_with_replacement(quantities, count):
        same = count == 2 and chosen[0] is chosen[1]
        text = f"{chosen[0].text}^2" if same else " ".join(term.text for term in chosen)
        found.append(Product(text, np.prod([term.value for term in chosen], axis=0) * np.ones(cases)))
    return found


def squared_sums(quantities: list[Product]) -> list[Product]:
    """``(a + b)^2`` and ``(a - b)^2`` of all pairs."""
    return [
        Product(f"({first.text} {mark} {second.text})^2", (first.value + sign * second.value) ** 2)
        for first, second in combinations(quantities, 2)
        for sign, mark in ((1, "+"), (-1, "-"))
    ]


def times(first: Product, second: Product) -> Product:
    return Product(" ".join(filter(None, (first.text, second.text))), first.value * second.value)


class Search:
    """Expressions of the given terms, each with value (g,)."""

    def __init__(self, terms: list[Product]) -> None:
        self._texts: list[str] = [term.text or "1" for term in terms]
        self._values = np.array([term.value for term in terms])
        few = len(terms) <= 400  # or the search takes seconds
        # the two of a pair and the sign of its second
        self._pairs = [(i, j, sign) for i, j in combinations(range(len(terms)), 2) for sign in (1, -1)] if few else []
        index = np.array(self._pairs, dtype=int).reshape(-1, 3)
        self._sums = self._values[index[:, 0]] + index[:, 2, None] * self._values[index[:, 1]]
        # up to which two numbers count as equal
        self._tolerance = 1e-8 * np.abs(self._values).max(axis=0)

    def simplest(self, value: Array) -> Expression | None:
        """The expression with the fewest terms; None if there is none. `value` (g,)."""
        return next(self._found(value), None)

    def _found(self, value: Array) -> Iterator[Expression]:
        factors = (1.0, -1.0, 2.0, -2.0, 0.5, -0.5)
        for factor in factors:
            for i in self._equal(self._values, value / factor):
                yield Expression(factor, "" if self._texts[i] == "1" else self._texts[i])
        for factor in factors:
            for pair in self._equal(self._sums, value / factor):
                yield Expression(factor, f"({self._pair(pair)})")
        if len(self._texts) > 80:
            return
        for factor in factors:
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


@dataclass(frozen=True)
class Dimension:
    """A distance or angle of the chain with a name, as it appears in the expressions."""

    symbol: str
    value: float
    unit: str  # m or rad
    meaning: str
    joint: int  # joint whose position in the link before it is given
    component: int  # of the translation, or of the axis about which the link is twisted


def symbolic_names(
    chain: Chain, columns: tuple[int, ...], combination: Array, combine: Callable[[Chain], Array | None]
) -> tuple[tuple[str, ...], tuple[Dimension, ...]]:
    """Names (r,) of the base parameters ``combination @ parameters`` and the dimensions used in them.

    columns (r,): the leading parameter of each; `combine` gives K (r, 11 n) of the same base for a chain with other
    dimensions, None if these columns are no base of it (then all coefficients stay decimals).
    """
    known = dimensions(chain)
    rng = np.random.default_rng(0)
    values = [np.array([dimension.value for dimension in known])]
    found = [combination]
    for _ in range(3):  # robots that an expression must also fit
        varied = values[0] * rng.uniform(0.7, 1.4, len(known))
        other = combine(with_dimensions(chain, known, varied))
        if other is None:
            known, values, found = (), [np.zeros(0)], [combination]
            break
        values.append(varied)
        found.append(other)
    speaker = _Speaker(chain, known, np.array(values), np.array(found))
    names = tuple(speaker.name(row, column) for row, column in enumerate(columns))
    words = set(re.findall(r"\w+", " ".join(names)))
    return names, tuple(dimension for dimension in known if dimension.symbol in words)


def dimensions(chain: Chain) -> tuple[Dimension, ...]:
    """Distances (l) from each joint to the next, in the frame of the link between, and twist angles (a) of a link."""
    found: list[Dimension] = []
    numbers = _numbers(chain)
    for k in range(1, len(chain.joints)):
        before, joint = chain.joints[k - 1], chain.joints[k]
        way = f"from {before.name} to {joint.name}"
        # m
        axes = [axis for axis in range(3) if abs(joint.translation[axis]) > 1e-9]
        for axis in axes:
            symbol = f"l{numbers[k - 1]}" + ("xyz"[axis] if len(axes) > 1 else "")
            meaning = f"{way} along {'xyz'[axis]} of {before.link}"
            found.append(Dimension(symbol, float(joint.translation[axis]), "m", meaning, k, axis))
        twist = _twist(joint)
        if twist is not None:
            axis, angle = twist
            meaning = f"twist {way} about {'xyz'[axis]} of {before.link}"
            found.append(Dimension(f"a{numbers[k - 1]}", angle, "rad", meaning, k, axis))
    return tuple(found)


def with_dimensions(chain: Chain, known: tuple[Dimension, ...], values: Array) -> Chain:
    """The chain with other values (d,) of its dimensions."""
    joints = list(chain.joints)
    for dimension, value in zip(known, values, strict=True):
        joint = joints[dimension.joint]
        if dimension.unit == "m":
            translation = joint.translation.copy()
            translation[dimension.component] = value
            joints[dimension.joint] = replace(joint, translation=translation)
        else:
            rotation = rotation_about(np.eye(3)[dimension.component], np.asarray(value))
            joints[dimension.joint] = replace(joint, rotation=rotation)
    return replace(chain, joints=tuple(joints))


class _Speaker:
    """Finds expressions for coefficients: `values` (g, d) of the dimensions, `found` (g, r, 11 n) the combinations."""

    def __init__(self, chain: Chain, known: tuple[Dimension, ...], values: Array, found: Array) -> None:
        self._parameters = parameter_names(chain)
        self._powers, self._links = _powers_of_length(chain), _links(chain)
        self._known, self._values, self._found = known, values, found
        self._searches: dict[tuple[int, int, int], Search] = {}

    def name(self, row: int, leader: int) -> str:
        """The base parameter: the leading one first, then those regrouped into it."""
        parts = [self._parameters[leader]]
        for column in np.flatnonzero(self._found[0, row]):
            if column != leader:
                parts.append(self._part(self._found[:, row, column], leader, int(column)))
        return " ".join(parts)

    def _part(self, coefficient: Array, leader: int, column: int) -> str:
        expression = self._search(leader, column).simplest(coefficient) or Expression(coefficient[0], "")
        size = abs(expression.factor)
        number = "" if abs(size - 1) < 1e-6 else f"{size:.4g} "  # counts as 1
        words = expression.text and f" {expression.text}"
        return f"{'-' if expression.factor < 0 else '+'} {number}{self._parameters[column]}{words}"

    def _search(self, leader: int, column: int) -> Search:
        """Terms that may be factors of a parameter: products, in its unit, of the dimensions between the two joints."""
        power = self._powers[leader] - self._powers[column]
        first, last = sorted((self._links[leader], self._links[column]))
        key = (first, last, power)
        if key not in self._searches:
            self._searches[key] = Search(self._terms([d.joint for d in self._known], first, last, power))
        return self._searches[key]

    def _terms(self, joints: list[int], first: int, last: int, power: int) -> list[Product]:
        cases = len(self._values)
        between = [k for k, joint in enumerate(joints) if first < joint <= last]
        lengths = [Product(self._known[k].symbol, self._values[:, k]) for k in between if self._known[k].unit == "m"]
        turns = [
            Product(f"{name}({self._known[k].symbol})", turn(self._values[:, k]))
            for k in between
            if self._known[k].unit == "rad"
            for name, turn in (("cos", np.cos), ("sin", np.sin))
        ]
        straight = products(lengths, power, cases) if power >= 0 else products([], 0, cases)
        if power == 2:
            straight += squared_sums(lengths)
        turned = [turn for count in (0, 1, 2) for turn in products(turns, count, cases)]
        return [times(length, turn) for turn in turned for length in straight]


def _twist(joint: Joint) -> tuple[int, float] | None:
    """Axis and angle of a joint that is twisted about one axis by an angle other than a quarter turn."""
    for axis in range(3):
        if abs(joint.rotation[axis, axis] - 1) < 1e-9:
            one, two = (axis + 1) % 3, (axis + 2) % 3
            angle = float(np.arctan2(joint.rotation[two, one], joint.rotation[one, one]))
            quarter = angle / (np.pi / 2)
            return None if abs(quarter - round(quarter)) < 1e-9 else (axis, angle)
    return None


def _numbers(chain: Chain) -> list[str]:
    """The numbers at the ends of the joints' names if they are all different; otherwise 1, 2, ... from the base."""
    found = [re.search(r"\d+$", joint.name) for joint in chain.joints]
    named = [match[0] for match in found if match is not None]
    return named if len(set(named)) == len(found) else [str(k + 1) for k in range(len(found))]


def _powers_of_length(chain: Chain) -> list[int]:
    """(11 n,) powers of length in the units: m 0, first moments 1, moments of inertia 2; motors as their joint."""
    motors = [0 if joint.kind == "prismatic" else 2 for joint in chain.joints]
    return [0, 1, 1, 1, 2, 2, 2, 2, 2, 2] * len(chain.joints) + motors


def _links(chain: Chain) -> list[int]:
    """(11 n,) number of the link or joint that a parameter belongs to."""
    count = len(chain.joints)
    return [k for k in range(count) for _ in range(10)] + list(range(count))
