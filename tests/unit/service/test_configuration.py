"""Files that somebody else wrote are looked at before they are believed."""

from pathlib import Path

import pytest

from service.configuration import DEEPEST, LARGEST_YAML, MOST_CHARACTERS, read_text, read_yaml
from service.errors import BadInput
from service.geometry.cell import Cell
from service.settings import load_settings

ALIASES = f"aliases stand for more than {MOST_CHARACTERS} characters"
LAUGHS = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
LAUGHS += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 10)]
DEEP = f"nested too deeply, limit {DEEPEST} levels"


@pytest.mark.parametrize(
    ("content", "told"),
    [
        pytest.param("\n".join(LAUGHS), ALIASES, id="less than 600 bytes for more than a thousand million values"),
        pytest.param(f"name: &a {'n' * 100_000}\nboxes: [{', '.join(['*a'] * 100)}]\n", ALIASES, id="a long text"),
        *(
            (f"name: {value}", "not YAML: a value is not of its type")
            for value in ("2001-13-45", "!!int ''", "!!bool x", "!!timestamp x")
        ),
        pytest.param(f"name: {'9' * 5000}", "not YAML: a value is not of its type", id="a long number"),
        *(  # what it stands for has no end
            (content, r"alias \*a is inside of its own anchor in .* line 1")
            for content in ("&a {b: *a}", "x: &a [1, {y: [*a]}]", "x: &a {<<: *a}")
        ),
        *(
            pytest.param(opened * levels + "1" + closed * levels, told, id=f"{levels} times {opened}")
            for opened, closed in (("[", "]"), ("{a: ", "}"), ("- ", ""))
            for levels, told in ((DEEPEST, "valid dictionary|unknown key"), (DEEPEST + 1, DEEP), (100_000, DEEP))
        ),
        pytest.param("#" * (LARGEST_YAML + 1), f"is larger than {LARGEST_YAML} bytes", id="large"),
    ],
)
def test_what_was_made_to_harm_is_refused(content: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(content, "utf-8")
    with pytest.raises(BadInput, match=told):
        read_yaml(path, Cell)


def test_keys_that_are_no_text_and_a_text_beyond_its_limit_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "service.yaml"
    path.write_text("1: 2", "utf-8")
    with pytest.raises(BadInput, match="key 1 is not text"):
        load_settings(path)
    with pytest.raises(BadInput, match="is larger than 3 bytes"):
        read_text(path, 3)


def test_a_few_aliases_are_fine(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text("name: &n workshop\nboxes:\n  - {name: *n, size: [1, 1, 1], center: [0, 0, 0]}\n", "utf-8")
    assert read_yaml(path, Cell).boxes[0].name == "workshop"
