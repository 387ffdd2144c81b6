"""`drivers.commission` finds each planted mismatch by name and without energy, and none in a sound machine."""

from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from canopen.objectdictionary import datatypes

from drivers.commission.sheet import Verdict
from tests.commission_bench import Cabinet, cabinet, words_of_energy
from tests.planted_mismatches import BOTH, CASES, KINDS, Case, typed


@pytest.fixture(scope="module", params=BOTH)
def drives(request: pytest.FixtureRequest) -> Iterator[Cabinet]:
    with cabinet(request.param) as bench:
        yield bench


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drives", "case"),
    [pytest.param(kind, case, id=f"{kind}-{case.name}") for kind in KINDS for case in CASES if kind in case.kinds],
    indirect=["drives"],
    scope="module",  # one cabinet of a kind: each case takes back what it planted
)
def test_a_planted_mismatch_is_told_by_its_name_before_energy(case: Case, drives: Cabinet, tmp_path: Path) -> None:
    drives.heard()
    with drives.planted(case.plant):
        sheet = drives.check(**case.change(drives.profile, tmp_path))
    assert {row.check for row in sheet.mismatches} == case.told, sheet.text()
    assert {row.joint for row in sheet.mismatches} == set(case.joints)
    assert words_of_energy(drives.heard()) == []
    assert "NOT fit for motion" in sheet.text()


def test_another_host_is_told_before_any_drive_is_asked(drives: Cabinet) -> None:
    drives.heard()
    speaking = drives.ear.send_periodic(can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False), 0.005)
    try:
        sheet = drives.check()
    finally:
        speaking.stop()
    assert [row.check for row in sheet.rows] == ["other-host"]
    assert not [frame for frame in drives.heard() if frame.arbitration_id & ~0x7F == 0x600]


def test_an_answer_of_4_bytes_is_told_and_no_mismatch(drives: Cabinet) -> None:
    with drives.planted(typed(0x6060, 0, datatypes.INTEGER32)):
        sheet = drives.check()
    assert sheet.mismatches == ()
    (mode,) = [row for row in sheet.rows if row.check == "object mode" and row.joint == "joint_1"]
    assert mode.verdict is Verdict.NOTE
    assert "sent in 4 bytes" in mode.what


@pytest.mark.slow
def test_a_sound_machine_has_none(drives: Cabinet) -> None:
    for _ in range(2):  # as new, and as configured by the first
        drives.heard()
        sheet = drives.check()
        assert sheet.mismatches == ()
        assert words_of_energy(heard := drives.heard()) == []
        assert len(heard) > 100
        assert set(sheet.excitation.values()) == {"cyclic_velocity (60FFh)"}
        assert sheet.text().endswith("Signature ____________________")
    assert [row.check for row in sheet.rows if row.check == "drive-limits" and row.verdict is Verdict.NOTE]


@pytest.mark.parametrize("dictionary", ["plain", "gold", "simpliq", "powerball"])
def test_sound_drives_of_other_makers_have_none(dictionary: str) -> None:
    with cabinet(dictionary) as bench:
        sheet = bench.check()
        assert sheet.mismatches == ()
        assert words_of_energy(bench.heard()) == []
        assert [row for row in sheet.rows if row.verdict is Verdict.HOST]
