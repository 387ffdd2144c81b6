"""`drivers.commission` finds each planted mismatch by name and without energy; what a small sine tells."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from canopen.objectdictionary import datatypes

from drivers.canopen import frames
from drivers.commission.drive import CheckVerdict
from drivers.commission.moving import judge
from drivers.ports import ChannelTiming
from tests.commission_bench import Cabinet, cabinet
from tests.planted_mismatches import BOTH, CASES, KINDS, Case, holds, typed


@pytest.fixture(scope="module", params=BOTH)
def drives(request: pytest.FixtureRequest) -> Iterator[Cabinet]:
    with cabinet(request.param) as bench:
        yield bench


def commands(messages: list[can.Message]) -> list[str]:
    """Every frame of a host that is not an SDO upload. A check that is killed at any time leaves what it found."""
    hosts = {frames.Cob.NMT, frames.Cob.SYNC, frames.Cob.HEARTBEAT + 127}
    uploads = {2, 3, 4, 5}  # client command specifiers, CiA 301: initiate, segment, abort, block
    return [
        f"{message.arbitration_id:03X}h {message.data.hex()}"
        for message in messages
        if message.arbitration_id in hosts
        or message.arbitration_id & ~0x7F in (0x200, 0x300, 0x400, 0x500)  # RPDOs
        or (message.arbitration_id & ~0x7F == 0x600 and message.data[0] >> 5 not in uploads)
    ]


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
    assert commands(drives.heard()) == []
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
    assert mode.verdict is CheckVerdict.NOTE
    assert "sent in 4 bytes" in mode.what


@pytest.mark.parametrize("dictionary", ["plain", "gold", "simpliq", "powerball"])
def test_sound_drives_of_other_makers_have_none(dictionary: str) -> None:
    with cabinet(dictionary) as bench:
        sheet = bench.check()
        assert sheet.mismatches == ()
        assert commands(bench.heard()) == []
        assert [row for row in sheet.rows if row.verdict is CheckVerdict.HOST]


def test_units_are_those_of_the_drive_once_a_connection_has_written_the_settings_of_its_map() -> None:
    with cabinet("epos4") as bench:  # in whole rev/min, as it leaves its maker
        slow = [axis | {"velocity_limit": 0.05} for axis in bench.profile["axes"]]
        sheet = bench.check(axes=slow)
    assert sheet.mismatches == ()
    told = [row.what for row in sheet.rows if row.check == "map-settings" and row.verdict is CheckVerdict.NOTE]
    assert len(told) == len(slow)
    assert all("60A9h" in what for what in told)


def test_limits_that_a_connection_wrote_are_no_ground_for_a_first_move(drives: Cabinet) -> None:
    host = drives.profile["bus"].get("host_node", 127)
    with drives.planted(holds(0x1016, 1, host << 16 | 777)):
        sheet = drives.check()
    assert {(row.joint, row.check) for row in sheet.mismatches} == {("joint_1", "drive-limits")}
    assert "power it off and on" in sheet.mismatches[0].what


def test_a_drive_that_does_not_obey_the_fieldbus_is_not_fit(drives: Cabinet) -> None:
    dictionary = drives.dictionary()
    upload = dictionary.upload

    def local(index: int, sub: int) -> bytes:
        data = upload(index, sub)
        return bytes([data[0], data[1] & ~2]) if (index, sub) == (0x6041, 0) else data

    drives.desk.done(lambda: setattr(dictionary, "upload", local))
    try:
        sheet = drives.check()
    finally:
        drives.desk.done(lambda: delattr(dictionary, "upload"))
    assert [(row.joint, row.check) for row in sheet.mismatches] == [("joint_1", "remote")]


def test_an_emcy_during_the_check_is_told_even_if_it_is_over(drives: Cabinet) -> None:
    alarm = can.Message(arbitration_id=0x81, data=bytes.fromhex("10 82 21 0000000000"), is_extended_id=False)
    over = can.Message(arbitration_id=0x81, data=bytes(8), is_extended_id=False)
    speaking = drives.ear.send_periodic([alarm, over], 0.005)
    try:
        sheet = drives.check()
    finally:
        speaking.stop()
    told = [row for row in sheet.mismatches if row.check == "emcy"]
    assert told
    assert {(row.joint, row.check) for row in sheet.mismatches} == {("joint_1", "emcy")}
    assert "8210h" in told[0].what


RATE, FREQUENCY, OFFSET, INERTIA, FRICTION = 250.0, 2.0, 0.015, 300.0, 150.0


def columns(*, scale: float = 1.0, late: float = 0.0, effort: float = 1.0, noise: float = 0.0) -> dict[str, Any]:
    """Four seconds of a turn with a sine on it; velocity times `scale` and `late` s, effort times `effort`."""
    time, angular = np.arange(int(4 * RATE)) / RATE, 2 * np.pi * FREQUENCY
    random = np.random.default_rng(3)

    def speed(at: Any) -> Any:
        return OFFSET + 0.6 * OFFSET * np.sin(angular * at)

    acceleration = 0.6 * OFFSET * angular * np.cos(angular * time)
    return {
        "time": time,
        "position": OFFSET * time - 0.6 * OFFSET / angular * np.cos(angular * time),
        "velocity": scale * speed(time - late) + noise * random.standard_normal(len(time)),
        "effort": effort * (INERTIA * acceleration + FRICTION),
        "velocity_setpoint": speed(time + 0.01),
    }


def judged(content: dict[str, Any], delay: float = 0.0) -> list[Any]:
    return judge(content, FREQUENCY, OFFSET, ChannelTiming(velocity_delay=delay), "rad", "N m")


def test_sound_channels_fit_and_tell_delay_and_noise() -> None:
    told = judged(columns(noise=1e-4))
    assert not [each for each in told if each.fits is False]
    assert "10.00 ms behind the set-point" in " ".join(each.what for each in told)
    noise = next(each.what for each in told if each.check == "noise" and each.what.startswith("velocity"))
    assert float(noise.split()[1]) == pytest.approx(1e-4, rel=0.1)


@pytest.mark.parametrize(
    ("content", "delay", "names"),
    [
        (columns(scale=2.0), 0.0, {"unit"}),
        (columns(scale=60.0), 0.0, {"unit"}),
        (columns(scale=-1.0), 0.0, {"sign", "unit", "delay"}),
        (columns(effort=-1.0), 0.0, {"sign"}),
        (columns(late=0.005), 0.0, {"delay"}),
        (columns(late=0.005), 0.005, set[str]()),  # as the profile tells it
    ],
)
def test_a_wrong_channel_is_told_by_its_name(content: dict[str, Any], delay: float, names: set[str]) -> None:
    assert {each.check for each in judged(content, delay) if each.fits is False} == names
