"""Files that somebody else wrote are looked at before they are believed."""

from pathlib import Path

import pytest

from service.cell import Cell
from service.configuration import LARGEST_YAML, MOST_ALIASES, read_text, read_yaml
from service.errors import BadInput


def test_aliases_of_aliases_are_refused(tmp_path: Path) -> None:
    """500 bytes that stand for more than a thousand million values."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 10)]
    path = tmp_path / "cell.yaml"
    path.write_text("\n".join(lines), "utf-8")
    assert path.stat().st_size < 600
    with pytest.raises(BadInput, match=f"more than {MOST_ALIASES} aliases"):
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
