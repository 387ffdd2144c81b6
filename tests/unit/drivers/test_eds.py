"""EDS files: a dictionary from the cache is what canopen reads and belongs to who asked; one without end is refused."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, cast

import canopen
import pytest
from canopen.objectdictionary import ODVariable

from drivers.commission.drive import read_dictionary
from drivers.eds import object_dictionary
from drivers.errors import BadProfile
from simulator.drive.dictionary import ObjectDictionary
from simulator.scenario import ScenarioError
from tests.foreign_bench import file_of

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


TEXT = (Path(__file__).parents[3] / "config/eds/virtual-axis.eds").read_text("utf-8")
NAMES = "[8000]\nParameterName=x\nObjectType=8\nDataType=5\nAccessType=ro\nCompactSubObj=9\n[8000Name]\nNrOfEntries="
FOREIGN = partial(ObjectDictionary, maker=None)
DICTIONARIES: Any = {"drivers": read_dictionary, "virtual": ObjectDictionary, "foreign": FOREIGN}


@pytest.mark.parametrize("read", DICTIONARIES.values(), ids=DICTIONARIES)
@pytest.mark.parametrize(
    ("more", "told"),
    [
        (f"{NAMES}99999999999\n", r"\[8000Name\] line \d+: NrOfEntries is 99999999999, limit 254"),
        (f"{NAMES}255\n".replace("=9", "=256"), r"\[8000\] line \d+: CompactSubObj is 256, limit 254"),
        (";" * 2**22, "is larger than 4194304 bytes"),
    ],
    ids=["names", "compact", "bytes"],
)
def test_an_eds_without_end_is_refused(
    read: Callable[[Path, int], object], more: str, told: str, tmp_path: Path
) -> None:
    """The library counts up to the number of entries, whatever it is."""
    path = tmp_path / "axis.eds"
    path.write_text(f"{TEXT}\n{more}", "utf-8")
    with pytest.raises((BadProfile, ScenarioError), match=told):
        read(path, 3)


def test_names_of_entries_are_read(tmp_path: Path) -> None:
    path = tmp_path / "axis.eds"
    entries = "".join(f"{number}=name {number}\n" for number in range(1, 255))
    path.write_text(f"{TEXT}\n{NAMES.replace('=9', '=254')}254\n{entries}", "utf-8")
    own, virtual, foreign = (read(path, 3) for read in DICTIONARIES.values())
    assert (0x8000, 254) in own.objects
    assert virtual.bits((0x8000, 254)) == foreign.bits((0x8000, 254)) == 8
