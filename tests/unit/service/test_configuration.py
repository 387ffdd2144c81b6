"""Files that somebody else wrote are looked at before they are believed."""

from pathlib import Path

import pytest

from service.configuration import DEEPEST, LARGEST_YAML, MOST_CHARACTERS, read_text, read_yaml
from service.errors import BadInput
from service.geometry.cell import Cell
from service.settings import load_settings


def test_aliases_of_aliases_are_refused(tmp_path: Path) -> None:
    """500 bytes that stand for more than a thousand million values."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 10)]
    path = tmp_path / "cell.yaml"
    path.write_text("\n".join(lines), "utf-8")
    assert path.stat().st_size < 600
    with pytest.raises(BadInput, match=f"aliases stand for more than {MOST_CHARACTERS} characters"):
        read_yaml(path, Cell)


@pytest.mark.parametrize("value", ["2001-13-45", "!!int ''", "!!bool x", "!!timestamp x", "9" * 5000])
def test_values_that_are_not_of_their_type_are_refused(value: str, tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(f"name: {value}", "utf-8")
    with pytest.raises(BadInput, match="not YAML: a value is not of its type"):
        read_yaml(path, Cell)


def test_keys_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "service.yaml"
    path.write_text("1: 2", "utf-8")
    with pytest.raises(BadInput, match="key 1 is not text"):
        load_settings(path)


@pytest.mark.parametrize("content", ["&a {b: *a}", "x: &a [1, {y: [*a]}]", "x: &a {<<: *a}"])
def test_an_alias_inside_of_its_own_anchor_is_refused(content: str, tmp_path: Path) -> None:
    """What it stands for has no end."""
    path = tmp_path / "cell.yaml"
    path.write_text(content, "utf-8")
    with pytest.raises(BadInput, match=r"alias \*a is inside of its own anchor in .* line 1"):
        read_yaml(path, Cell)


def test_a_long_text_with_many_aliases_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(f"name: &a {'n' * 100_000}\nboxes: [{', '.join(['*a'] * 100)}]\n", "utf-8")
    with pytest.raises(BadInput, match="aliases stand for more than"):
        read_yaml(path, Cell)


@pytest.mark.parametrize(("opened", "closed"), [("[", "]"), ("{a: ", "}"), ("- ", "")])
def test_the_limit_of_nesting(opened: str, closed: str, tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(opened * DEEPEST + "1" + closed * DEEPEST, "utf-8")
    with pytest.raises(BadInput, match=r"valid dictionary|unknown key"):
        read_yaml(path, Cell)
    for levels in (DEEPEST + 1, 100_000):
        path.write_text(opened * levels + "1" + closed * levels, "utf-8")
        with pytest.raises(BadInput, match=f"nested too deeply, limit {DEEPEST} levels"):
            read_yaml(path, Cell)


def test_a_few_aliases_are_fine(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text("name: &n workshop\nboxes:\n  - {name: *n, size: [1, 1, 1], center: [0, 0, 0]}\n", "utf-8")
    assert read_yaml(path, Cell).boxes[0].name == "workshop"


def test_large_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_bytes(b"#" * (LARGEST_YAML + 1))
    with pytest.raises(BadInput, match=f"is larger than {LARGEST_YAML} bytes"):
        read_yaml(path, Cell)
    with pytest.raises(BadInput, match="is larger than 4 bytes"):
        read_text(path, 4)
