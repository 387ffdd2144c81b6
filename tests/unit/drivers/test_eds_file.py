"""EDS files that say of themselves that they never end, read by drivers and by both kinds of virtual drives."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.commission.dictionary import read_dictionary
from drivers.errors import BadProfile
from simulator.drive.dictionary import Dictionary
from simulator.foreign.dictionary import ForeignDictionary
from simulator.scenario import ScenarioError

EDS = (Path(__file__).parents[3] / "config/eds/virtual-axis.eds").read_text("utf-8")
NAMES = "[8000]\nParameterName=x\nObjectType=8\nDataType=5\nAccessType=ro\nCompactSubObj=9\n[8000Name]\nNrOfEntries="
READERS: Any = {"drivers": read_dictionary, "virtual": Dictionary, "foreign": ForeignDictionary}


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
@pytest.mark.parametrize(
    ("more", "told"),
    [
        (f"{NAMES}99999999999\n", r"\[8000Name\] line \d+: NrOfEntries is 99999999999, limit 254"),
        (f"{NAMES}255\n".replace("=9", "=255"), r"\[8000\] line \d+: CompactSubObj is 255, limit 254"),
        (";" * 2**22, "is larger than 4194304 bytes"),
    ],
    ids=["names", "compact", "bytes"],
)
def test_an_eds_without_end_is_refused(
    read: Callable[[Path, int], object], more: str, told: str, tmp_path: Path
) -> None:
    """The library counts up to the number of entries, whatever it is."""
    path = tmp_path / "axis.eds"
    path.write_text(f"{EDS}\n{more}", "utf-8")
    with pytest.raises((BadProfile, ScenarioError), match=told):
        read(path, 3)


def test_names_of_entries_are_read(tmp_path: Path) -> None:
    path = tmp_path / "axis.eds"
    entries = "".join(f"{number}=name {number}\n" for number in range(1, 255))
    path.write_text(f"{EDS}\n{NAMES.replace('=9', '=254')}254\n{entries}", "utf-8")
    own, virtual, foreign = (read(path, 3) for read in READERS.values())
    assert (0x8000, 254) in own.objects
    assert virtual.mapping((0x8000, 254)) is not None
    assert foreign.bits((0x8000, 254)) == 8
