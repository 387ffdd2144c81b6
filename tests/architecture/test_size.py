"""What the house has reached stays: its figures of `tests.architecture.size`, and one meaning for one name."""

import ast
import re
from collections import defaultdict
from pathlib import Path

import pytest

from tests.architecture.size import PRODUCT, ROOT, constants, figures

LIMITS = {
    "rooms of the service": 14,
    "layers of the service": 8,
    "class names defined twice or more": 4,
    "constants of modules": 600,
    "of these outside of wire and store": 0,  # dict[str, Any] and JsonValue
    "import statements per 1,000 lines": 54,
    "words of the documents": 60_000,
}
TERMS = 120  # of the glossary


@pytest.mark.slow
def test_no_figure_grows_above_its_limit() -> None:
    found = dict(figures())
    assert {name: found[name] for name, limit in LIMITS.items() if int(found[name]) > limit} == {}


def test_the_glossary_stays_short_and_has_each_term_once() -> None:
    page = (ROOT / "docs/reference/words.md").read_text("utf-8").partition("## In German")[0]
    terms = [term for term in re.findall(r"^\| ([^|]+?) +\|", page, re.MULTILINE) if term != "term"]
    assert 50 < len(terms) <= TERMS
    assert len(set(terms)) == len(terms)


def rooms() -> list[Path]:
    """Folders whose modules share their names: of the service each room, of the rest each folder."""
    return sorted(
        path for top in PRODUCT for path in (ROOT / top).iterdir() if path.is_dir() and any(path.glob("*.py"))
    )


@pytest.mark.parametrize("room", rooms(), ids=lambda room: str(room.relative_to(ROOT)))
def test_a_constant_has_one_value_in_a_room(room: Path) -> None:
    values: dict[str, set[str]] = defaultdict(set)
    for path in room.rglob("*.py"):
        for node in ast.parse(path.read_text("utf-8")).body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                module = ast.Module([node], [])
                for name in set(constants(module)) - {"LIBRARY_ERRORS"}:  # of each reader of traces
                    values[name].add(ast.unparse(node.value))
    assert {name: found for name, found in values.items() if len(found) > 1} == {}
