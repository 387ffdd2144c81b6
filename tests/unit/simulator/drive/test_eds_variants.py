"""The dictionary and the three EDS files of the one virtual drive: what bus and axis make of them."""

import struct
from configparser import RawConfigParser
from pathlib import Path

import pytest

from simulator import ScenarioError
from simulator.drive.dictionary import AbortCode, ObjectDictionary, SdoAbort
from simulator.drive.limits import speed_unit
from simulator.drive.makers import VIRTUAL
from simulator.drive.power_drive import DriveState, FaultCode
from tests.unit.simulator.conftest import Rig

EDS = Path(__file__).parents[4] / "config/eds"
MINIMAL = "[DeviceInfo]\nVendorNumber=1\n\n[6040]\nParameterName=Controlword\nObjectType=7\nDataType=6\nAccessType=rw\n"


def sections(name: str) -> dict[str, dict[str, str]]:
    parser = RawConfigParser()
    parser.read(EDS / f"{name}.eds")
    return {section: dict(parser[section]) for section in parser.sections()}


def objects(name: str) -> set[str]:
    return {section for section in sections(name) if section[0] in "126" and "sub" not in section}


def test_the_variants_differ_in_what_they_are_about_alone() -> None:
    assert objects("virtual-axis") - objects("virtual-axis-no-limits") == {"6072", "607D", "607F", "6080"}
    assert objects("virtual-axis") - objects("virtual-axis-rpm") == {"2104", "2140"}
    full, rpm, bare = sections("virtual-axis"), sections("virtual-axis-rpm"), sections("virtual-axis-no-limits")
    changed = {"6083", "6084", "6085", "605A", "60A9", "1018sub2", "FileInfo", "DeviceInfo"}
    no_noise = {"2100", "2100sub0", "2100subC", "ManufacturerObjects"}
    assert {name for name in full if full[name] != rpm.get(name)} - {
        section for section in full if section[:4] in ("2104", "2140")
    } == changed | no_noise
    assert {name for name in full if full[name] != bare.get(name)} - {
        section for section in full if section[:4] in ("6072", "607D", "607F", "6080")
    } == {"FileInfo", "Comments", "OptionalObjects"}
    for content in (rpm, bare):
        for part in ("OptionalObjects", "ManufacturerObjects"):
            assert int(content[part]["supportedobjects"]) == len(content[part]) - 1


def test_rev_per_min_everywhere() -> None:
    d = ObjectDictionary(EDS / "virtual-axis-rpm.eds", 3)
    assert speed_unit(d) == 60.0
    d[0x6076, 0], d[0x6080, 0], d[0x607F, 0], d[0x6081, 0] = 20_000, 3000, 3000, 600
    d[0x607D, 1], d[0x607D, 2] = -100 << 20, 100 << 20
    rig = Rig(d)
    assert rig.axis.limits.speed == 50.0
    assert rig.axis.limits.ramp(0x6083) == pytest.approx(1000 / 60)  # as the other EDS' default
    rig.enable(9)
    rig.stream(2.0, 0.0)
    assert rig.turn(4, 4) == pytest.approx([0.5, 1.0, 1.5, 2.0])
    rig.stream(2.0, 0.004)
    rig.turn(4, 4)
    assert d[0x606C, 0] == 120
    rig.stream(3001 / 60, 0.008)
    assert d[0x603F, 0] == FaultCode.SPEED_LIMIT


def test_a_dictionary_of_one_object_drives_an_axis_by_the_defaults(tmp_path: Path) -> None:
    path = tmp_path / "minimal.eds"
    path.write_text(MINIMAL)
    rig = Rig(ObjectDictionary(path, 1))
    for controlword in (0x06, 0x07, 0x0F):
        rig.dictionary.download(0x6040, 0, struct.pack("<H", controlword))
    rig.turn(8)
    assert rig.state is DriveState.OPERATION_ENABLED
    assert all(rig.dictionary[key] is not None for key in VIRTUAL.absent)
    with pytest.raises(SdoAbort) as refused:
        rig.dictionary.upload(0x6041, 0)
    assert refused.value.code is AbortCode.NO_OBJECT
    rig.axis.fail(0x7305)
    rig.turn(8)
    assert rig.state is DriveState.FAULT


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("no section at all", "not an EDS"),
        (MINIMAL.replace("DataType=6", "DataType=six"), r"\[6040\] line \d+: DataType=six"),
        (MINIMAL + "[VirtualDrive]\nBlockUpload=perhaps\n", "perhaps"),
        (
            MINIMAL + "[60A9]\nParameterName=u\nObjectType=7\nDataType=7\nAccessType=const\nDefaultValue=0x00010000\n",
            "60A9h",
        ),
    ],
)
def test_what_is_no_eds_for_this_drive_is_refused(tmp_path: Path, text: str, named: str) -> None:
    path = tmp_path / "bad.eds"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=named):
        Rig(ObjectDictionary(path, 1))


@pytest.mark.parametrize(
    ("key", "data", "code"),
    [
        ((0x7000, 0), b"\0", AbortCode.NO_OBJECT),
        ((0x2101, 17), bytes(8), AbortCode.NO_SUBINDEX),
        ((0x6041, 0), b"\0\0", AbortCode.READ_ONLY),
        ((0x1000, 0), bytes(4), AbortCode.READ_ONLY),
        ((0x6040, 0), b"\0", AbortCode.TOO_SHORT),
        ((0x6040, 0), b"\0\0\0", AbortCode.TOO_LONG),
        ((0x605A, 0), struct.pack("<h", 7), AbortCode.TOO_HIGH),
        ((0x605A, 0), struct.pack("<h", -1), AbortCode.TOO_LOW),
        ((0x6072, 0), struct.pack("<H", 5001), AbortCode.TOO_HIGH),
        ((0x6085, 0), bytes(4), AbortCode.TOO_LOW),
        ((0x2100, 9), struct.pack("<H", 17), AbortCode.TOO_HIGH),
    ],
)
def test_refuses_with_the_code_of_the_standard_and_keeps_the_value(
    dictionary: ObjectDictionary, key: tuple[int, int], data: bytes, code: AbortCode
) -> None:
    known = key in dictionary
    before = dictionary[key] if known else None
    with pytest.raises(SdoAbort) as refused:
        dictionary.download(*key, data)
    assert refused.value.code is code
    assert not known or dictionary[key] == before
