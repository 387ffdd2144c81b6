"""Bytes -> events -> samples; nothing on the bus can break it."""

import struct

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen import frames
from drivers.canopen.frames import BusOff, Emergency, Heartbeat, Motion, Place, decode
from drivers.canopen.measuring import SAMPLE
from drivers.canopen.samples import Pairing


def test_events_by_hand() -> None:
    assert decode(0x181, bytes.fromhex("3706 18fcffff 9cff")) == Motion(1, 0x0637, -1000, -100)
    assert decode(0x282, bytes.fromhex("ffffffff 2a000000")) == Place(2, -1, 42)
    assert decode(0x083, bytes.fromhex("0573 21 0102030405")) == Emergency(3, 0x7305, 0x21, bytes([1, 2, 3, 4, 5]))
    assert decode(0x704, b"\x85") == Heartbeat(4, 5)
    assert decode(0x040, b"", error=True) == BusOff()
    assert decode(0x004, bytes(8), error=True) is None
    assert decode(0x080, b"") is None  # SYNC
    assert frames.rpdo1(0x0F, -2) == bytes.fromhex("0f00 feffffff")


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=64), st.booleans())
def test_no_frame_can_break_the_decoder(identifier: int, data: bytes, error: bool) -> None:
    event = decode(identifier, data, error)
    assert event is None or isinstance(event, Motion | Place | Emergency | Heartbeat | BusOff)


def motion(velocity: int) -> Motion:
    return Motion(1, 0x27, velocity, 5)


def test_pairs_of_one_sync_are_numbered_by_the_drive() -> None:
    pairing = Pairing(99)
    for number in range(3):
        pairing.motion(motion(number))
        sample = pairing.place(Place(1, 7 * number, 100 + number))
        assert sample is not None
        assert (sample.index, sample.velocity, sample.position) == (number, number, 7 * number)


def test_lost_and_doubled_frames() -> None:
    pairing = Pairing(0)
    seen: list[tuple[int, int]] = []

    def feed(*events: Motion | Place) -> None:
        for event in events:
            if isinstance(event, Motion):
                pairing.motion(event)
            elif (sample := pairing.place(event)) is not None:
                seen.append((sample.index, sample.velocity))

    feed(motion(0), Place(1, 0, 1))
    feed(Place(1, 0, 2))  # TPDO1 lost
    feed(motion(2), Place(1, 0, 3))
    feed(motion(3))  # TPDO2 lost
    feed(motion(4), motion(4), Place(1, 0, 5), Place(1, 0, 5))  # both doubled
    assert seen == [(0, 0), (2, 2), (4, 4)]


def test_a_counter_that_wraps_or_stands_still() -> None:
    pairing = Pairing(0xFFFFFFFE)
    indices: list[int] = []
    for counter in (0xFFFFFFFF, 0, 0, 1):
        pairing.motion(motion(0))
        sample = pairing.place(Place(1, 0, counter))
        indices += [] if sample is None else [sample.index]
    assert indices == [0, 1, 2]


@given(st.lists(st.one_of(st.none(), st.integers(0, 0xFFFFFFFF)), max_size=50), st.integers(0, 0xFFFFFFFF))
def test_indices_only_grow(counters: list[int | None], base: int) -> None:
    pairing = Pairing(base)
    last = -1
    for counter in counters:
        if counter is None:
            pairing.motion(motion(0))
        elif (sample := pairing.place(Place(1, 0, counter))) is not None:
            assert sample.index > last
            last = sample.index


def test_trace_sample_by_hand() -> None:
    raw = struct.pack("<Ifffdd", 7, 1.5, 60.0, 59.5, 12.25, 0.125)
    sample = np.frombuffer(raw, SAMPLE)[0]
    assert sample.tolist() == (7, 1.5, 60.0, 59.5, 12.25, 0.125)
