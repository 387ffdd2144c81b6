"""Register maps, the shipped ones and bad ones, which are told with file and place; the page of the trace."""

import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, strategies as st

from simulator.modbus.registers import (
    RegisterLayout,
    RegisterMapError,
    SampleField,
    TraceMap,
    TracePage,
    Wire,
    WordOrder,
    load_register_map,
    page_registers,
)

REGISTERS = Path(__file__).parents[4] / "config/registers"
NAMES = ("virtual-high-first", "virtual-low-first")


def load(name: str) -> RegisterLayout:
    return load_register_map(REGISTERS / f"{name}.yaml")


@pytest.mark.parametrize("name", NAMES)
def test_shipped_maps_are_wide_and_fine_enough(name: str) -> None:
    registers = load(name)
    needed = {  # largest value and resolution
        "position": (1000.0, 1e-6),
        "target_position": (1000.0, 1e-6),
        "position_min": (1000.0, 1e-6),
        "frequency": (100.0, 1e-6),
        "amplitude": (1000.0, 1e-4),
        "phase": (math.pi, 1e-6),
        "max_speed": (6000.0, 1e-2),
    }
    for signal, (largest, resolution) in needed.items():
        wire = registers.signals[signal]
        step = {"f32": math.pi * 2**-22}.get(wire.type, wire.scale)
        if wire.type != "f32":
            assert step <= resolution, signal
        back = wire.decode(wire.encode(largest, registers.word_order), registers.word_order)
        assert back == pytest.approx(largest, rel=1e-6), signal


@given(
    kind=st.sampled_from(["u16", "i16", "u32", "i32"]),
    order=st.sampled_from(["high_first", "low_first"]),
    value=st.floats(allow_nan=True, allow_infinity=True),
)
def test_integers_take_the_nearest_value_they_can_hold(kind: Any, order: Any, value: float) -> None:
    wire = Wire(type=kind, scale=0.5)
    back = wire.decode(wire.encode(value, order), order)
    bits = int(kind[1:])
    low, high = (0, 2**bits - 1) if kind[0] == "u" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    if math.isnan(value):
        assert back == low / 2
    else:
        assert abs(back - max(low / 2, min(high / 2, value))) <= 0.25


Change = Callable[[dict[str, Any]], object]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda m: m["signals"].pop("watchdog"), r"missing \['watchdog'\]"),
        (lambda m: m["signals"].update(spare=m["signals"]["mode"]), r"unknown \['spare'\]"),
        (lambda m: m["signals"]["velocity"].update(unit="rpm"), "signals.velocity: unit rpm must be rev/min"),
        (lambda m: m["signals"]["velocity"].update(scale=0), "signals.velocity.scale: Input should be greater than 0"),
        (lambda m: m["signals"]["velocity"].update(type="i64"), "signals.velocity.type"),
        (lambda m: m["signals"]["velocity"].update(adress=1), "signals.velocity.adress: Extra inputs"),
        (lambda m: m["signals"]["frequency"].update(count=8), "signals.frequency: count 8 must be 16"),
        (lambda m: m["signals"]["constant"].pop("value"), "signals.constant: value is needed for constant and not"),
        (lambda m: m["signals"]["product"].update(address=1), r"register 1 belongs to constant"),
        (lambda m: m["trace"]["page"].update(address=65000), "trace.page: reaches beyond register 65535"),
        (lambda m: m["trace"]["page"].update(registers=5), "trace.page: holds no whole sample"),
        (lambda m: m["trace"]["sample"].pop(), "trace.sample: signals and units"),
        (lambda m: m.update(word_order="middle"), "word_order"),
        (lambda m: m.update(max_read=126), "max_read"),
    ],
)
def test_a_bad_map_is_told_with_its_place(tmp_path: Path, change: Change, reason: str) -> None:
    content = yaml.safe_load((REGISTERS / "virtual-low-first.yaml").read_text())
    change(content)
    path = tmp_path / "map.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(RegisterMapError, match=reason) as caught:
        load_register_map(path)
    assert str(caught.value).startswith(str(path))


TRACE = TraceMap(
    page=TracePage(address=0, registers=20),
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
    ("page", "order", "first", "count", "expected"),
    [
        (PAGE, "high_first", 0, 18, FIRST + SECOND),
        (PAGE, "high_first", 0, 3, FIRST[:3]),
        (PAGE, "high_first", 7, 4, FIRST[7:] + SECOND[:2]),
        (PAGE, "high_first", 9, 9, SECOND),
        (PAGE, "high_first", 16, 4, [0, 2500, 0, 0]),
        (PAGE, "high_first", 18, 2, [0, 0]),
        (PAGE, "low_first", 0, 9, [0xFFFC, 4464, 1, 0, 0x3F80, 7, 0xFFFE, 0, 0x8000]),
        (b"", "high_first", 3, 4, [0] * 4),  # nothing was recorded
        (PAGE * 2, "high_first", 15, 5, [*SECOND[6:], 0, 0]),  # more than the page holds
    ],
)
def test_a_page_in_any_cut(page: bytes, order: WordOrder, first: int, count: int, expected: list[int]) -> None:
    assert page_registers(page, TRACE, order, first, count) == expected
