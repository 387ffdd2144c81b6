"""Bytes -> events; nothing on the bus can break it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen import frames
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


def test_error_counters_are_told() -> None:
    event = decode(0x204, bytes.fromhex("0020 00000000 80 07"), error=True)
    assert str(event) == "error passive (transmit errors 128, receive errors 7)"
