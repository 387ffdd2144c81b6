"""Frames as events; which only another host can have sent; what is heard on a bus that another host uses."""

import struct
import uuid
from pathlib import Path

import can
import pytest
import yaml
from hypothesis import given, strategies as st

from drivers.canopen import frames
from drivers.canopen.bus import CanopenBus, ForeignFrames
from drivers.canopen.frames import (
    Controller,
    ControllerState,
    Emergency,
    Heartbeat,
    MotionPdo,
    PositionPdo,
    SetPoint,
    decode,
)
from drivers.canopen.profile import STANDARD, BusProfile, Entry, parse_profile
from drivers.canopen.stop_sender import HeardState, upload_request
from drivers.cia402.states import Controlword
from tests.unit.drivers.test_bus import soon

HOST, NODES = 127, (1, 2)

TRESPASSES = {
    "heartbeat with node number 127, which this host uses (COB-ID 77Fh)": (frames.Cob.HEARTBEAT + HOST, b"\x05"),
    "SYNC (COB-ID 080h)": (frames.Cob.SYNC, b""),
    "NMT command 01h to node 2 (COB-ID 000h)": (frames.Cob.NMT, b"\x01\x02"),
    "NMT command 81h to every node (COB-ID 000h)": (frames.Cob.NMT, b"\x81\x00"),
    "NMT command 80h to node 1 (COB-ID 000h)": (frames.Cob.NMT, b"\x80\x01"),
    "RPDO1 to node 1 (COB-ID 201h)": (frames.Cob.RPDO1 + 1, frames.rpdo1(Controlword.ENABLE_OPERATION, 7)),
    "RPDO2 to node 2 (COB-ID 302h)": (frames.Cob.RPDO2 + 2, b"\x00"),
    "SDO request to node 1 (COB-ID 601h)": (frames.Cob.SDO_REQUEST + 1, bytes(8)),
}
OTHERS = (
    (frames.Cob.HEARTBEAT + 1, b"\x05"),
    (frames.Cob.HEARTBEAT + 9, b"\x05"),
    (frames.Cob.NMT, b"\x01\x09"),
    (frames.Cob.NMT, b"\x01"),
    (frames.Cob.RPDO1 + 9, frames.rpdo1(Controlword.ENABLE_OPERATION, 7)),
    (frames.Cob.SDO_REQUEST + 9, bytes(8)),
    (frames.Cob.SDO_RESPONSE + 1, bytes(8)),
    (frames.Cob.TPDO1 + 1, bytes(8)),
    (frames.Cob.EMERGENCY + 1, bytes(8)),
)


@pytest.mark.parametrize(
    ("frame", "what"),
    [*((frame, what) for what, frame in TRESPASSES.items()), *((frame, "") for frame in OTHERS)],
    ids=str,
)
def test_what_only_another_host_says(frame: tuple[int, bytes], what: str) -> None:
    said = ForeignFrames(NODES, HOST).word(*frame)
    assert said == (what and f"another host is on the bus: {what}")


def test_the_stop_of_the_stop_process_is_none_and_excuses_one_sync_and_some_questions() -> None:
    strangers, reading = ForeignFrames(NODES, HOST), upload_request(STANDARD["statusword"])
    stops = (*frames.stop(NODES, ()), *frames.stop(NODES, NODES))
    assert strangers.word(frames.Cob.SDO_REQUEST + 1, reading) != ""  # without a stop
    assert {strangers.word(*frame) for frame in stops} == {""}
    assert strangers.word(frames.Cob.SDO_REQUEST + 1, b"\x2b" + bytes(7)) != ""  # it writes
    questions = [strangers.word(frames.Cob.SDO_REQUEST + 1, reading) for _ in range(ForeignFrames.readings + 1)]
    assert [word != "" for word in questions] == [False] * ForeignFrames.readings + [True]
    assert strangers.word(frames.Cob.SYNC, b"") != ""


def test_a_stop_by_an_rpdo_of_its_own_is_no_stranger_either() -> None:
    """Where positions are streamed, quick stop has an RPDO with the controlword alone."""
    wires = frames.Wires(set_point=2, stop=1, counted=False)
    strangers = ForeignFrames((3,), HOST, wires)
    assert {strangers.word(*frame) for frame in frames.stop((3,), (3,), wires=wires)} == {""}
    assert "RPDO1 to node 3" in ForeignFrames((3,), HOST).word(*wires.stop_frame(3))


def test_a_bus_hears_them_once_it_was_alone() -> None:
    what, (identifier, data) = next(iter(TRESPASSES.items()))
    channel = f"strangers-{uuid.uuid4()}"
    message = can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
    with can.Bus(interface="virtual", channel=channel) as peer:
        bus = CanopenBus(BusProfile(interface="virtual", channel=channel, drive_timeout=60.0), NODES)
        try:
            peer.send(message)
            peer.send(can.Message(arbitration_id=frames.Cob.HEARTBEAT + 1, data=b"\x00", is_extended_id=False))
            soon(lambda: bus.restarted(1))  # both were heard
            assert bus.watch.reason == ""
            bus.expect_no_host()
            for ours in (*frames.stop(NODES, ()), (frames.Cob.HEARTBEAT + HOST, b"\x05"), (frames.Cob.SYNC, b"")):
                bus.send(*ours)
            peer.send(message)
            soon(lambda: bus.watch.reason != "")
            assert what in bus.watch.reason
        finally:
            bus.close()


def test_events_by_hand() -> None:
    assert decode(0x181, bytes.fromhex("3706 18fcffff 9cff")) == MotionPdo(1, 0x0637, -1000, -100)
    assert decode(0x282, bytes.fromhex("ffffffff 2a000000")) == PositionPdo(2, -1, 42)
    assert decode(0x083, bytes.fromhex("0573 21 0102030405")) == Emergency(3, 0x7305, 0x21, bytes([1, 2, 3, 4, 5]))
    assert decode(0x704, b"\x85") == Heartbeat(4, 5)
    assert decode(0x202, bytes(6)) == SetPoint(2, bytes(6))
    assert decode(0x080, b"") is None  # SYNC
    assert frames.rpdo1(0x0F, -2) == bytes.fromhex("0f00 feffffff")


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=64), st.booleans())
def test_no_frame_can_break_the_decoder(identifier: int, data: bytes, error: bool) -> None:
    event = decode(identifier, data, error)
    assert event is None or isinstance(event, frames.Frame)


@pytest.mark.parametrize(
    ("classes", "data", "state"),
    [
        (0x040, "", ControllerState.BUS_OFF),
        (0x244, "0030000000000000", ControllerState.BUS_OFF),
        (0x100, "0000000000000000", ControllerState.RESTARTED),
        (0x204, "0008000000000000", ControllerState.WARNING),
        (0x204, "0004000000000000", ControllerState.WARNING),
        (0x204, "0028000000000000", ControllerState.PASSIVE),
        (0x204, "0040000000000000", ControllerState.ACTIVE),
        (0x204, "0001000000000000", None),  # receive overflow
        (0x008, "0000000000000000", None),  # protocol violation
    ],
)
def test_error_frames_by_hand(classes: int, data: str, state: ControllerState | None) -> None:
    expected = None if state is None else Controller(state, 0, 0)
    assert decode(classes, bytes.fromhex(data), error=True) == expected


OFF, ON = 0x40, 0x27  # switch on disabled, operation enabled


@pytest.fixture
def heard(root: Path) -> HeardState:
    file = root / "config" / "drives" / "virtual-max100.yaml"
    profile = parse_profile(yaml.safe_load(file.read_text("utf-8")), file.parent)
    return HeardState(profile.axes[0], profile.device_map)


def replied(entry: Entry, value: int) -> bytes:
    data = struct.pack("<" + entry.type, value)
    return struct.pack("<BHB", {2: 0x4B, 4: 0x43}[len(data)], entry.index, entry.sub) + data.ljust(4, b"\0")


def exchanged(heard: HeardState, name: str, value: int, at: float) -> None:
    heard.requested(upload_request(STANDARD[name]), at)
    heard.answered(replied(STANDARD[name], value), at + 0.001)


def test_process_data_confirm_standstill_without_energy(heard: HeardState) -> None:
    assert heard.doubt(0.0) == "its state cannot be heard here"
    heard.note(frames.Heartbeat(1, 5), 0.5)
    assert heard.doubt(0.0) == "does not report its state"
    for status, velocity, doubt in ((ON, 0, "is 'operation enabled'"), (OFF, 7, "turns at 7"), (OFF, 0, "")):
        heard.note(frames.MotionPdo(1, status, velocity, 0), 1.0)
        assert heard.doubt(0.0).startswith(doubt)
    assert heard.doubt(1.0) == "does not report its state"  # older than the stop


def test_answers_to_the_service_confirm_it_if_the_velocity_is_not_older_than_the_state(heard: HeardState) -> None:
    for at, name, value, doubt in (
        (1.0, "velocity", 0, "its state cannot be heard here"),
        (2.0, "statusword", OFF, "its state cannot be heard here"),  # it may have begun to turn since
        (3.0, "velocity", 0, ""),
        (4.0, "statusword", ON, "is 'operation enabled'"),
    ):
        exchanged(heard, name, value, at)
        assert heard.doubt(0.5) == doubt


def test_a_segment_that_looks_like_an_answer_is_none(heard: HeardState) -> None:
    off = replied(STANDARD["statusword"], OFF)
    exchanged(heard, "statusword", ON, 1.0)
    heard.answered(off, 1.1)
    heard.answered(replied(STANDARD["velocity"], 0), 1.2)
    assert heard.doubt(0.5) == "is 'operation enabled'"
    heard.requested(b"\xa0" + upload_request(STANDARD["statusword"])[1:], 1.3)  # a block upload
    heard.answered(off, 1.4)
    assert heard.doubt(0.5) == "is 'operation enabled'"


def test_a_velocity_within_the_noise_counts_only_in_a_unit_that_was_heard(heard: HeardState) -> None:
    heard.note(frames.MotionPdo(1, OFF, 1, 0), 1.0)
    assert heard.doubt(0.5).startswith("turns at 1 velocity units, standstill is at most 0")
    exchanged(heard, "velocity_unit", 0xFDB44700, 0.1)  # 1e-3 rev/min
    exchanged(heard, "increments", 1048576, 0.1)
    exchanged(heard, "motor_revolutions", 1, 0.1)
    assert heard.doubt(0.5) == ""


def test_it_asks_for_what_is_missing_and_awaits_each_answer(heard: HeardState) -> None:
    now, asked = 1.0, list[str]()
    values = {"statusword": OFF, "velocity": 0, "velocity_unit": 0xFDB44700, "increments": 1, "motor_revolutions": 1}
    while heard.doubt(0.5) and len(asked) < 10:
        request = heard.question(0.5, now)
        assert heard.question(0.5, now + 0.01) == b""
        name = next(name for name in values if upload_request(STANDARD[name]) == request)
        asked.append(name)
        heard.answered(replied(STANDARD[name], values[name]), now + 0.02)
        now += 0.03
    assert heard.doubt(0.5) == ""
    assert asked[-1] == "velocity"
