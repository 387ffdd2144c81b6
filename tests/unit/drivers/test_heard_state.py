"""What is heard of an axis on a bus that another host uses, and that nothing else is taken for it."""

import struct
from pathlib import Path

import pytest
import yaml

from drivers.canopen import frames, objects
from drivers.canopen.heard_state import HeardState, upload_request
from drivers.canopen.objects import Entry
from drivers.canopen.profile import parse_profile

OFF, ON = 0x40, 0x27  # switch on disabled, operation enabled


@pytest.fixture
def heard(root: Path) -> HeardState:
    file = root / "config" / "drives" / "virtual-max100.yaml"
    profile = parse_profile(yaml.safe_load(file.read_text("utf-8")), file.parent)
    return HeardState(profile.axes[0], profile.device_map)


def answer(entry: Entry, value: int) -> bytes:
    data = struct.pack("<" + entry.type, value)
    return struct.pack("<BHB", {2: 0x4B, 4: 0x43}[len(data)], entry.index, entry.sub) + data.ljust(4, b"\0")


def exchanged(heard: HeardState, entry: Entry, value: int, at: float) -> None:
    heard.requested(upload_request(entry), at)
    heard.answered(answer(entry, value), at + 0.001)


def test_process_data_confirm_standstill_without_energy(heard: HeardState) -> None:
    assert heard.doubt(0.0) == "its state cannot be heard here"
    heard.note(frames.Heartbeat(1, 5), 0.5)
    assert heard.doubt(0.0) == "does not report its state"
    for status, velocity, doubt in ((ON, 0, "is 'operation enabled'"), (OFF, 7, "turns at 7"), (OFF, 0, "")):
        heard.note(frames.MotionPdo(1, status, velocity, 0), 1.0)
        assert heard.doubt(0.0).startswith(doubt)
    assert heard.doubt(1.0) == "does not report its state"  # older than the stop


def test_answers_to_the_service_confirm_it_if_the_velocity_is_not_older_than_the_state(heard: HeardState) -> None:
    exchanged(heard, objects.VELOCITY, 0, 1.0)
    exchanged(heard, objects.STATUSWORD, OFF, 2.0)
    assert heard.doubt(0.5) != ""  # it may have begun to turn since
    exchanged(heard, objects.VELOCITY, 0, 3.0)
    assert heard.doubt(0.5) == ""
    exchanged(heard, objects.STATUSWORD, ON, 4.0)
    assert heard.doubt(0.5) == "is 'operation enabled'"


def test_a_segment_that_looks_like_an_answer_is_none(heard: HeardState) -> None:
    exchanged(heard, objects.STATUSWORD, ON, 1.0)
    heard.answered(answer(objects.STATUSWORD, OFF), 1.1)
    heard.answered(answer(objects.VELOCITY, 0), 1.2)
    assert heard.doubt(0.5) == "is 'operation enabled'"
    heard.requested(b"\xa0" + upload_request(objects.STATUSWORD)[1:], 1.3)  # a block upload
    heard.answered(answer(objects.STATUSWORD, OFF), 1.4)
    assert heard.doubt(0.5) == "is 'operation enabled'"


def test_a_velocity_within_the_noise_counts_only_in_a_unit_that_was_heard(heard: HeardState) -> None:
    heard.note(frames.MotionPdo(1, OFF, 1, 0), 1.0)
    assert heard.doubt(0.5).startswith("turns at 1 velocity units, standstill is at most 0")
    exchanged(heard, objects.VELOCITY_UNIT, 0xFDB44700, 0.1)  # 1e-3 rev/min
    exchanged(heard, objects.INCREMENTS, 1048576, 0.1)
    exchanged(heard, objects.MOTOR_REVOLUTIONS, 1, 0.1)
    assert heard.doubt(0.5) == ""


def test_it_asks_for_what_is_missing_and_awaits_each_answer(heard: HeardState) -> None:
    now, asked = 1.0, list[str]()
    values = {"statusword": OFF, "velocity": 0, "velocity_unit": 0xFDB44700, "increments": 1, "motor_revolutions": 1}
    entries = {
        "statusword": objects.STATUSWORD,
        "velocity": objects.VELOCITY,
        "velocity_unit": objects.VELOCITY_UNIT,
        "increments": objects.INCREMENTS,
        "motor_revolutions": objects.MOTOR_REVOLUTIONS,
    }
    while heard.doubt(0.5) and len(asked) < 10:
        request = heard.question(0.5, now)
        assert heard.question(0.5, now + 0.01) == b""
        name = next(name for name, entry in entries.items() if upload_request(entry) == request)
        asked.append(name)
        heard.answered(answer(entries[name], values[name]), now + 0.02)
        now += 0.03
    assert heard.doubt(0.5) == ""
    assert asked[-1] == "velocity"
