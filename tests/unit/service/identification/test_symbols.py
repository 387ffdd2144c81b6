"""Base parameters in words: what is written gives the numbers, and says which distance it means."""

import re
from pathlib import Path

import numpy as np
import pytest

from service.identification.model import BaseParameters, combination_of, lock, parameter_names
from service.identification.model.base_parameters import base_parameters
from service.identification.model.symbols import (
    Dimension,
    Product,
    Search,
    dimensions,
    products,
    symbolic_names,
)
from service.model import Chain, read_chain
from tests.random_chain import random_urdf

MAX100 = Path(__file__).parents[4] / "config/robots/max100-class.urdf"
SCARA = """<robot name="scara"><link name="base"/><link name="inner"/><link name="outer"/><link name="quill"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="inner"/><origin xyz="0 0 0.4"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
<joint name="elbow" type="revolute"><parent link="inner"/><child link="outer"/><origin xyz="0.5 0 0"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
<joint name="lift" type="prismatic"><parent link="outer"/><child link="quill"/><origin xyz="0.5 0 0"/>
<axis xyz="0 0 -1"/><limit lower="0" upper="0.3" velocity="1" effort="1"/></joint></robot>"""


def named(chain: Chain, axes: tuple[int, ...]) -> tuple[BaseParameters, tuple[str, ...], tuple[Dimension, ...]]:
    base = base_parameters(chain, axes)
    names, known = symbolic_names(
        chain, base.columns, base.combination, lambda other: combination_of(other, axes, base.columns)
    )
    return base, names, known


def value(text: str, known: tuple[Dimension, ...]) -> float:
    """The number that an expression such as ``(l1x^2 - l2 cos(a2))`` stands for."""
    text = re.sub(r"(?<=[\w)]) (?=[\w(])", " * ", text).replace("^", "**")
    names = {"cos": np.cos, "sin": np.sin} | {dimension.symbol: dimension.value for dimension in known}
    return float(eval(text or "1", {"__builtins__": {}}, names))


def coefficients(name: str, parameters: tuple[str, ...], known: tuple[Dimension, ...]) -> np.ndarray:
    """The row of K that a name spells out."""
    row = np.zeros(len(parameters))
    spelled = "|".join(re.escape(parameter) for parameter in parameters)
    brackets = r"\((?:[^()]|\([^()]*\))*\)"
    word = rf"(?:\w+(?:\(\w+\))?|{brackets})(?:\^2)?"
    for sign, number, parameter, words in re.findall(rf"(?:^|([+-]) )(?:([\d.e-]+) )?({spelled})((?: {word})*)", name):
        size = float(number or 1) * value(words.strip(), known)
        row[parameters.index(parameter)] = -size if sign == "-" else size
    return row


TWISTED = SCARA.replace('xyz="0.5 0 0"/>', 'xyz="0.5 0 0" rpy="0.3 0 0"/>', 1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "locked", "axes", "digits"),
    [  # four digits where decimals are left: with the twists of a joint locked in between
        (MAX100.read_text(), {3: 0.0, 4: 0.0, 5: 0.0}, (0, 1, 2), 1e-9),
        (MAX100.read_text(), {}, (0, 1, 2, 3, 4, 5), 1e-9),
        (MAX100.read_text(), {}, (2, 4), 1e-9),
        (MAX100.read_text(), {2: 0.3, 4: 0.2}, (0, 1), 1e-3),
        (SCARA, {}, (0, 1, 2), 1e-9),
        (TWISTED, {}, (0, 1), 1e-3),
    ],
)
def test_what_is_written_gives_the_numbers(
    text: str, locked: dict[int, float], axes: tuple[int, ...], digits: float
) -> None:
    chain = lock(read_chain(text), locked)
    base, names, known = named(chain, axes)
    for name, row in zip(names, base.combination, strict=True):
        np.testing.assert_allclose(coefficients(name, parameter_names(chain), known), row, rtol=digits)
    assert digits > 1e-9 or not re.findall(r"\d\.\d", " ".join(names))


def test_of_the_paper_s_three_axes() -> None:
    chain = lock(read_chain(MAX100.read_text()), {3: 0.0, 4: 0.0, 5: 0.0})
    _, names, known = named(chain, (0, 1, 2))
    assert names[0].startswith("Izz(link_1) + m(link_2) l1x^2 + Izz(link_2) + m(link_3) l1x^2")
    assert names[2] == "mz(link_2) + m(link_3) l2"
    assert names[4] == "Iyy(link_2) + m(link_3) l2^2 + Jm(joint_2) - Jm(joint_3)"
    assert [(one.symbol, one.value, one.unit) for one in known] == [("l1x", 0.35, "m"), ("l2", 1.15, "m")]
    assert known[1].meaning == "from joint_2 to joint_3 along z of link_2"


@pytest.mark.slow
def test_two_distances_of_one_length_are_told_apart() -> None:
    chain = read_chain(SCARA)
    _, names, known = named(chain, (0, 1, 2))
    assert [one.symbol for one in dimensions(chain)] == ["l1", "l2"]
    assert {one.value for one in known} == {0.5}
    assert names[0].startswith("Izz(inner) + m(outer) l1^2")
    assert "2 mx(quill) l2" in " ".join(names)


@pytest.mark.slow
def test_a_twist_is_an_angle() -> None:
    _, names, known = named(read_chain(TWISTED), (0, 1))
    assert "cos(a1)" in " ".join(names)
    (twist,) = [one for one in known if one.unit == "rad"]
    assert twist.value == pytest.approx(0.3)
    assert twist.meaning == "twist from shoulder to elbow about x of inner"


def test_askew_axes_keep_their_decimals() -> None:
    chain = read_chain(random_urdf(np.random.default_rng(1), 4))
    base, names, _ = named(chain, (0, 1, 2, 3))
    assert len(names) == len(base.names)
    assert re.search(r"\d\.\d+ [mI]", " ".join(names))


def test_the_simplest_expression_is_found() -> None:
    a, b = Product("a", np.array([2.0, 3.0, 7.0])), Product("b", np.array([2.0, 5.0, 1.5]))
    search = Search(products([a, b], 2, 3))
    for wanted, factor, text in (
        (a.value**2, 1.0, "a^2"),
        (-2 * a.value * b.value, -2.0, "a b"),
        (a.value**2 - b.value**2, 1.0, "(a^2 - b^2)"),
        ((a.value**2 + b.value**2 - a.value * b.value) / 2, 0.5, "(a^2 + b^2 - a b)"),
    ):
        found = search.simplest(wanted)
        assert found is not None
        assert found.factor == factor
        assert sorted(found.text.strip("()").split()) == sorted(text.strip("()").split())
    assert search.simplest(a.value) is None
    assert search.simplest(a.value**2 + np.array([0, 0, 1e-3])) is None  # equal in two of three cases
