"""Each numeric constant of the mathematics has a row with its value, meaning and source on a page."""

import ast
import re

import pytest

from tests.constants_page import PAGE, ROOT, in_code, on_page, same

pytestmark = pytest.mark.slow

KINDS = ("paper", "statistics", "derived", "equation", "exact", "physics", "field", "scores", "chosen")


@pytest.fixture(scope="module")
def page() -> dict[str, list[str]]:
    return on_page(PAGE.read_text("utf-8"))


def test_every_constant_has_a_row_and_every_row_a_constant(page: dict[str, list[str]]) -> None:
    code = in_code()
    assert len(code) > 400
    assert sorted(code.keys() - page.keys()) == [], "without a row in docs/reference/constants.md"
    assert sorted(page.keys() - code.keys()) == [], "in docs/reference/constants.md, not in the code"


def test_every_row_has_the_value_of_the_code(page: dict[str, list[str]]) -> None:
    code = in_code()
    wrong = [
        f"{key}: page {cells[0]}, code {code[key]}" for key, cells in page.items() if not _value_is(cells, code[key])
    ]
    assert wrong == []


def test_every_row_has_a_meaning_and_a_source(page: dict[str, list[str]]) -> None:
    for key, (_, meaning, source) in page.items():
        assert meaning, key
        assert re.split(r"[:, ]", source)[0] in KINDS, f"{key}: {source}"
        if source.startswith("chosen"):
            assert len(source) > len("chosen: "), key


def test_files_named_as_a_source_exist() -> None:
    named = set(re.findall(r"`(tests/[\w/.]+\.py)`", PAGE.read_text("utf-8")))
    assert named
    assert [name for name in sorted(named) if not (ROOT / name).is_file()] == []


def test_the_measured_constants_still_have_a_value_that_was_measured() -> None:
    code = {key.split(" ")[1]: value for key, value in in_code().items()}
    measured: dict[str, list[float]] = {}
    table = PAGE.read_text("utf-8").partition("## Measured: halved and doubled")[2]
    for name, value in re.findall(r"^\| `([\w.]+)` \| ([\d.e-]+) \|", table, re.MULTILINE):
        measured.setdefault(name, []).append(float(value))
    assert len(measured) == 12
    assert {name for name, values in measured.items() if float(code[name]) not in values} == set()


def _value_is(cells: list[str], code: str) -> bool:
    """The code of a row's value, before its unit, is the same expression."""
    found = re.match(r"`([^`]*)`", cells[0])
    assert found, cells
    ast.parse(found[1])
    return same(found[1], code)
