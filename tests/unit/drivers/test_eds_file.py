"""EDS files that say of themselves that they never end."""

from pathlib import Path

import pytest

from drivers.commission.dictionary import read_dictionary
from drivers.errors import BadProfile

EDS = (Path(__file__).parents[3] / "config/eds/virtual-axis.eds").read_text("utf-8")
NAMES = "[8000]\nParameterName=x\nObjectType=8\nDataType=5\nAccessType=ro\nCompactSubObj=9\n[8000Name]\nNrOfEntries="


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (f"{NAMES}99999999999\n", "section 8000Name: NrOfEntries is 99999999999, limit 254"),
        (f"{NAMES}\n  255\n", "section 8000Name: NrOfEntries is .*255, limit 254"),
        (";" * 2**22, "is larger than 4194304 bytes"),
    ],
)
def test_an_eds_without_end_is_refused(more: str, told: str, tmp_path: Path) -> None:
    """The library counts up to the number of entries, whatever it is."""
    path = tmp_path / "axis.eds"
    path.write_text(f"{EDS}\n{more}", "utf-8")
    with pytest.raises(BadProfile, match=told):
        read_dictionary(path, 3)


def test_names_of_entries_are_read(tmp_path: Path) -> None:
    path = tmp_path / "axis.eds"
    entries = "".join(f"{number}=name {number}\n" for number in range(1, 255))
    path.write_text(f"{EDS}\n{NAMES}254\n{entries}", "utf-8")
    assert (0x8000, 254) in read_dictionary(path, 3).objects
