"""Each field that a script of the pages reads of an answer is one of docs/reference/openapi.json."""

from pathlib import Path

import pytest

from tests.page_types.compiler import check
from tests.unit.service.hmi.page_words import SCRIPTS

pytestmark = pytest.mark.slow


def test_each_field_is_one_of_the_api(tmp_path: Path) -> None:
    assert check(SCRIPTS, tmp_path) == []


def test_a_field_of_a_value_without_a_type_is_found(tmp_path: Path) -> None:
    """The compiler alone lets it pass."""
    code = "export function shown(one) { return one.created_at; }\n"
    found = check({"planted.js": code}, tmp_path)
    assert [(one.file, one.line, one.text) for one in found] == [
        ("planted.js", 1, "a field of a value without a type: one.created_at")
    ]
