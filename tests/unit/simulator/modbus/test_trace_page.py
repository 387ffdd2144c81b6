"""Samples of the drive's trace as they lie in the page, against values packed by hand."""

import math
import struct

import pytest

from simulator.modbus.register_map import Page, SampleField, TraceMap
from simulator.modbus.trace_page import page_registers

TRACE = TraceMap(
    page=Page(address=0, registers=20),
    sample=(
        SampleField(signal="torque", type="i16", scale=0.5, unit="N m"),
        SampleField(signal="cycle", type="u32"),
        SampleField(signal="set_speed", type="f32", unit="rev/min"),
        SampleField(signal="speed", type="u16", unit="rev/min"),
        SampleField(signal="position", type="i16", scale=0.001, unit="rev"),
        SampleField(signal="load_position", type="i32", scale=0.001, unit="rev"),
    ),
)
PAGE = struct.pack("<Ifffdd", 70000, -2.0, 1.0, 7.4, -0.002, math.nan)
PAGE += struct.pack("<Ifffdd", 70001, 1e9, -1.0, -7.0, 3000.0, 2.5)
FIRST = [0xFFFC, 1, 4464, 0x3F80, 0, 7, 0xFFFE, 0x8000, 0]
SECOND = [0x7FFF, 1, 4465, 0xBF80, 0, 0, 0x7FFF, 0, 2500]


@pytest.mark.parametrize(
    ("first", "count", "expected"),
    [
        (0, 18, FIRST + SECOND),
        (0, 3, FIRST[:3]),
        (7, 4, FIRST[7:] + SECOND[:2]),
        (9, 9, SECOND),
        (16, 4, [0, 2500, 0, 0]),
        (18, 2, [0, 0]),
    ],
)
def test_high_word_first_in_any_cut(first: int, count: int, expected: list[int]) -> None:
    assert page_registers(PAGE, TRACE, "high_first", first, count) == expected


def test_low_word_first() -> None:
    assert page_registers(PAGE, TRACE, "low_first", 0, 9) == [0xFFFC, 4464, 1, 0, 0x3F80, 7, 0xFFFE, 0, 0x8000]


def test_nothing_recorded_and_more_than_the_page_holds() -> None:
    assert page_registers(b"", TRACE, "high_first", 3, 4) == [0] * 4
    assert page_registers(PAGE * 2, TRACE, "high_first", 15, 5) == [*SECOND[6:], 0, 0]
