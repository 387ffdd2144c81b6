"""A dictionary from the cache is what canopen reads from the file, and belongs to who asked for it."""

from pathlib import Path
from typing import Any, cast

import pytest

from drivers.eds import object_dictionary
from tests.foreign_bench import file_of

import canopen  # isort: skip - after lean_can
from canopen.objectdictionary import ODVariable  # isort: skip

OWN = Path(__file__).parents[3] / "config" / "eds" / "virtual-axis.eds"


def variables(objects: Any) -> dict[tuple[int, int], dict[str, object]]:
    """Every attribute of every object, less what refers to the objects around it."""
    found: dict[tuple[int, int], dict[str, object]] = {}
    for entry in objects.values():
        for each in [entry] if isinstance(entry, ODVariable) else entry.values():
            found[each.index, each.subindex] = {name: value for name, value in vars(each).items() if name != "parent"}
    return found


@pytest.mark.parametrize("file", [OWN, file_of("plain")], ids=lambda file: file.stem)
def test_each_node_gets_what_canopen_reads(file: Path) -> None:
    for node in (1, 5, 1, 5):
        expected = cast(Any, canopen).import_od(str(file), node)
        found = object_dictionary(file, node)
        assert variables(found) == variables(expected)
        assert found.node_id == expected.node_id
        assert vars(found.device_information) == vars(expected.device_information)


def test_who_changes_a_dictionary_changes_no_other() -> None:
    first = object_dictionary(OWN, 1)
    first[0x6040].default = 77
    assert object_dictionary(OWN, 1)[0x6040].default != 77


def test_a_file_that_was_changed_is_read_again(tmp_path: Path) -> None:
    file = tmp_path / "a.eds"
    file.write_text(OWN.read_text("utf-8"), "utf-8")
    before = len(object_dictionary(file, 1))
    file.write_text(OWN.read_text("utf-8").partition("[6040]")[0], "utf-8")
    assert len(object_dictionary(file, 1)) < before
