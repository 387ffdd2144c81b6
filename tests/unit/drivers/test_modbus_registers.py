"""Profiles and register maps of drives on Modbus: those that stand, every rule once; values in registers."""

import copy
import math
from pathlib import Path
from typing import Any, cast

import pytest
import yaml
from hypothesis import given, strategies as st

from drivers.errors import BadProfile, LimitExceeded
from drivers.modbus import from_profile
from drivers.modbus.profile import RtuProfile, parse_profile
from drivers.modbus.registers import MEASURING, Format, WireType, WordOrder, parse_registers, spans
from drivers.registry import load_profile

MAPS = Path(__file__).parents[3] / "config" / "registers"
HIGH: dict[str, Any] = yaml.safe_load((MAPS / "virtual-high-first.yaml").read_text())


def changed(**signals: Any) -> dict[str, Any]:
    """The map with fields of signals changed."""
    content = copy.deepcopy(HIGH)
    for name, fields in signals.items():
        content["signals"][name] |= fields
    return content


def test_spans_join_what_follows_and_fits() -> None:
    signals = parse_registers(HIGH).signals
    asked = [signals[name] for name in ("serial", "vendor", "product", "revision", "statusword")]
    assert [[each.name for each in span] for span in spans(asked, 125)] == [
        ["vendor", "product", "revision", "serial"],
        ["statusword"],
    ]
    assert [len(span) for span in spans(asked, 4)] == [2, 2, 1]


def test_a_map_without_measuring_function_and_limits_is_a_map() -> None:
    content = copy.deepcopy(HIGH)
    for name in (*MEASURING, "max_torque", "watchdog"):
        del content["signals"][name]
    del content["trace"]
    assert parse_registers(content).trace is None


def test_every_rule() -> None:
    def without(name: str) -> dict[str, Any]:
        content = copy.deepcopy(HIGH)
        del content["signals"][name]
        return content

    def trace(**fields: Any) -> dict[str, Any]:
        return {**HIGH, "trace": {**HIGH["trace"], **fields}}

    sample = HIGH["trace"]["sample"]
    bad = {
        "missing": without("statusword"),
        "a measuring function needs": without("page_first"),
        "trace: needed with a measuring function, not allowed without one": {
            key: value for key, value in HIGH.items() if key != "trace"
        },
        r"unknown \['spede'\]": {**HIGH, "signals": {**HIGH["signals"], "spede": HIGH["signals"]["velocity"]}},
        "signals.velocity: unit rad/s must be rev/min": changed(velocity={"unit": "rad/s"}),
        "signals.statusword: must be a whole number": changed(statusword={"scale": 2.0}),
        "signals.controlword: access must be rw": changed(controlword={"access": "ro"}),
        "signals.statusword: access must be ro": changed(statusword={"access": "rw"}),
        "signals.velocity: count must be 1": changed(velocity={"count": 2}),
        "signals.vendor: value is needed for the constant and not allowed elsewhere": changed(vendor={"value": 7}),
        "two different words": changed(constant={"value": 0x12341234}),
        "must be u32 or i32": changed(constant={"type": "u16", "value": 7}),
        "hold its value": changed(constant={"value": -1}),
        "product: register 0103h belongs to vendor": changed(vendor={"address": 0x0102}, product={"address": 0x0103}),
        "beyond register FFFFh": changed(phase={"address": 0xFFF0}),
        "signals.velocity.scale": changed(velocity={"scale": 0}),
        "signals.velocity.type": changed(velocity={"type": "i64"}),
        "signals.velocity.address": changed(velocity={"address": 0x10000}),
        "word_order": {**HIGH, "word_order": "middle"},
        "max_read": {**HIGH, "max_read": 126},
        "do not fit a page": {**HIGH, "max_read": 10},
        "must be .*, the last only": trace(sample=sample[1:]),
        "sample torque: unit": trace(sample=[{**field, "unit": None} for field in sample]),
    }
    bad["must be a mapping"] = cast(Any, [1])
    for message, content in bad.items():
        with pytest.raises(BadProfile, match=message):
            parse_registers(content)


FIRST, LAST = WordOrder.HIGH_FIRST, WordOrder.LOW_FIRST
RANGES: dict[WireType, tuple[int, int]] = {
    "u16": (0, 2**16 - 1),
    "i16": (-(2**15), 2**15 - 1),
    "u32": (0, 2**32 - 1),
    "i32": (-(2**31), 2**31 - 1),
}


def test_by_hand() -> None:
    assert Format("u32", FIRST).encode(0x12345678) == [0x1234, 0x5678]
    assert Format("u32", LAST).encode(0x12345678) == [0x5678, 0x1234]
    assert Format("i16", LAST).encode(-2) == [0xFFFE]
    assert Format("i32", FIRST, 0.001).encode(-1.5) == [0xFFFF, 0xFA24]  # -1500
    assert Format("f32", FIRST).encode(-2.5) == [0xC020, 0]
    assert Format("i32", FIRST, 0.001).decode([0xFFFF, 0xFA24, 0, 1500]).tolist() == [-1.5, 1.5]
    assert Format("f32", LAST).decode([0, 0xC020]).tolist() == [-2.5]


def test_rounding_is_the_callers() -> None:
    assert Format("u16", FIRST).encode(7.9, math.floor) == [7]
    assert Format("u16", FIRST).encode(7.1, math.ceil) == [8]


@pytest.mark.parametrize("order", WordOrder)
@pytest.mark.parametrize("kind", RANGES)
@given(data=st.data(), scale=st.floats(1e-9, 1e6))
def test_integers_come_back_exactly(kind: WireType, order: WordOrder, data: st.DataObject, scale: float) -> None:
    raw = data.draw(st.integers(*RANGES[kind]))
    form = Format(kind, order, scale)
    registers = form.encode(raw * scale)
    assert len(registers) == form.width
    assert form.decode(registers).tolist() == [raw * scale]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 2.0**31, -(2.0**31) - 1])
def test_what_does_not_fit_is_refused(value: float) -> None:
    with pytest.raises(LimitExceeded, match="i32"):
        Format("i32", FIRST).encode(value)


def test_clip_gives_what_fits() -> None:
    form = Format("i16", FIRST, 0.1)
    assert form.clip(1e9) == pytest.approx(3276.7)
    assert form.clip(-1e9) == pytest.approx(-3276.8)
    assert form.encode(form.clip(math.inf)) == [0x7FFF]


DRIVES = Path(__file__).parents[3] / "config" / "drives"
TCP, RTU = (load_profile(DRIVES / f"virtual-max100-modbus-{kind}.yaml") for kind in ("tcp", "rtu"))


def other(profile: dict[str, object], **fields: Any) -> dict[str, Any]:
    return {**copy.deepcopy(profile), **fields}


def test_serial_silence_is_at_least_the_standards() -> None:
    def silence(baudrate: int, own: float = 0.0) -> float:
        return RtuProfile(
            transport="rtu", device="x", baudrate=baudrate, parity="E", silence_between_frames=own
        ).silence

    assert silence(9600) == pytest.approx(3.5 * 11 / 9600)
    assert silence(115200) == pytest.approx(1.75e-3)
    assert silence(115200, 0.01) == pytest.approx(0.01)


def test_what_a_read_takes_on_a_serial_line() -> None:
    line = RtuProfile(transport="rtu", device="x", baudrate=115200, parity="N")
    assert line.read_time(120) == pytest.approx(1.75e-3 + 253 * 10 / 115200)  # 24 ms


def test_what_is_refused() -> None:
    line: Any = TCP["line"]
    axes: Any = TCP["axes"]
    bad = {
        "line": other(TCP, line={**line, "transport": "ascii"}),
        "line.tcp.host": other(TCP, line={key: value for key, value in line.items() if key != "host"}),
        "line.tcp.device": other(TCP, line={**line, "device": "/dev/ttyUSB0"}),
        "must be at least twice": other(TCP, line={**line, "watchdog": 1.0}),
        "registers: no file": other(TCP, registers="none.yaml"),
        "axes.0.unit_id: 0 is not 1 to 247": other(TCP, axes=[{**axes[0], "unit_id": 0}, axes[1]]),
        "axes.1.unit_id: 255 is not": other(RTU, axes=[axes[0], {**axes[1], "unit_id": 255}]),
        "axes.0.unit_id: 248 is not": other(TCP, axes=[{**axes[0], "unit_id": 248}]),
        "must each be different": other(TCP, axes=[axes[0], {**axes[1], "unit_id": 1}]),
        "axes.0.node": other(TCP, axes=[{**axes[0], "node": 1}]),
    }
    for message, profile in bad.items():
        with pytest.raises(BadProfile, match=message):
            from_profile(profile, DRIVES)


@pytest.mark.parametrize("unit", [0, 255])
def test_a_drive_that_is_addressed_directly(unit: int) -> None:
    axes: Any = TCP["axes"]
    assert parse_profile(other(TCP, axes=[{**axes[0], "unit_id": unit}]), DRIVES).axes[0].unit_id == unit


def test_a_bad_register_map_is_a_bad_profile(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text("word_order: high_first\nsignals: {}\n")
    with pytest.raises(BadProfile, match=r"registers: .*map\.yaml: signals: missing"):
        from_profile(other(TCP, registers=str(tmp_path / "map.yaml")), DRIVES)
