"""Constants of the mathematics that decide results are on a page with value, meaning and source, as the code has them.

The other constants are listed from the code when the site is built (`docs/_ext/constants.py`).
"""

import ast
import re

import pytest

from tests.constants_page import PAGE, ROOT, in_code, on_page, same

pytestmark = pytest.mark.slow

KINDS = ("paper", "statistics", "scores")


@pytest.fixture(scope="module")
def page() -> dict[str, list[str]]:
    return on_page(PAGE.read_text("utf-8"))


@pytest.fixture(scope="module")
def code() -> dict[str, list[str]]:
    """Values by `file.NAME`: of as many folders as have it."""
    found: dict[str, list[str]] = {}
    for key, value in in_code().items():
        found.setdefault(key.partition(" ")[2], []).append(value)
    return found


def test_every_row_is_of_one_constant_and_has_its_value(page: dict[str, list[str]], code: dict[str, list[str]]) -> None:
    assert len(page) > 30
    assert sorted(page.keys() - code.keys()) == [], "in docs/reference/constants.md, not in the code"
    assert [name for name in page if len(code[name]) != 1] == [], "in several folders"
    wrong = [
        f"{name}: page {cells[0]}, code {code[name][0]}"
        for name, cells in page.items()
        if not _value_is(cells, code[name][0])
    ]
    assert wrong == []


def test_every_row_has_a_meaning_and_a_source(page: dict[str, list[str]]) -> None:
    for key, (_, meaning, source) in page.items():
        assert meaning, key
        assert re.split(r"[:, ]", source)[0] in KINDS, f"{key}: {source}"


def test_files_named_as_a_source_exist() -> None:
    named = set(re.findall(r"`(tests/[\w/.]+\.py)`", PAGE.read_text("utf-8")))
    assert named
    assert [name for name in sorted(named) if not (ROOT / name).is_file()] == []


def test_the_measured_constants_still_have_a_value_that_was_measured(code: dict[str, list[str]]) -> None:
    table = PAGE.read_text("utf-8").partition("## Measured: halved and doubled")[2]
    measured = dict(re.findall(r"^\| `([\w.]+)` \| ([\d.e-]+) \|", table, re.MULTILINE))
    assert len(measured) == 12
    assert {name for name, value in measured.items() if float(value) not in map(float, code[name])} == set()


def _value_is(cells: list[str], code: str) -> bool:
    """The code of a row's value, before its unit, is the same expression."""
    found = re.match(r"`([^`]*)`", cells[0])
    assert found, cells
    ast.parse(found[1])
    return same(found[1], code)
