"""Register maps: the two that stand, every rule once, and junk."""

import copy
from pathlib import Path
from typing import Any, cast

import pytest
import yaml

from drivers.errors import BadProfile
from drivers.modbus.registers import MEASURING, load_registers, parse_registers, spans

MAPS = Path(__file__).parents[3] / "config" / "registers"
HIGH: dict[str, Any] = yaml.safe_load((MAPS / "virtual-high-first.yaml").read_text())


def changed(**signals: Any) -> dict[str, Any]:
    """The map with fields of signals changed."""
    content = copy.deepcopy(HIGH)
    for name, fields in signals.items():
        content["signals"][name] |= fields
    return content


@pytest.mark.parametrize("name", ["virtual-high-first", "virtual-low-first"])
def test_the_maps_that_stand(name: str) -> None:
    registers = load_registers(MAPS / f"{name}.yaml")
    assert registers.trace is not None
    assert registers.max_read // registers.trace.width > 1
    motion = [registers.signals[signal] for signal in ("position", "velocity", "torque")]
    assert len(spans(motion, registers.max_read)) == 1  # one request tells the motion


def test_spans_join_what_follows_and_fits() -> None:
    signals = parse_registers(HIGH).signals
    asked = [signals[name] for name in ("serial", "vendor", "product", "revision", "statusword")]
    assert [[each.name for each in span] for span in spans(asked, 125)] == [
        ["vendor", "product", "revision", "serial"],
        ["statusword"],
    ]
    assert [len(span) for span in spans(asked, 4)] == [2, 2, 1]


def test_elements_of_an_array() -> None:
    elements = parse_registers(HIGH).signals["frequency"].elements()
    assert [(each.name, each.address) for each in elements[:2]] == [("frequency 1", 0x3000), ("frequency 2", 0x3002)]
    assert len(elements) == 16


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
