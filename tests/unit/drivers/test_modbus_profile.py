"""Profiles of drives on Modbus: the two that stand, and what is refused."""

import copy
from pathlib import Path
from typing import Any

import pytest

from drivers.errors import BadProfile
from drivers.modbus import from_profile
from drivers.modbus.profile import RtuLine, TcpLine, parse_profile
from drivers.registry import load_profile, open_drive

DRIVES = Path(__file__).parents[3] / "config" / "drives"
TCP, RTU = (load_profile(DRIVES / f"virtual-max100-modbus-{kind}.yaml") for kind in ("tcp", "rtu"))


def changed(profile: dict[str, object], **fields: Any) -> dict[str, Any]:
    return {**copy.deepcopy(profile), **fields}


def test_the_profiles_that_stand() -> None:
    tcp, rtu = parse_profile(TCP, DRIVES), parse_profile(RTU, DRIVES)
    assert isinstance(tcp.line, TcpLine)
    assert isinstance(rtu.line, RtuLine)
    assert [axis.unit_id for axis in rtu.axes] == [1, 2, 3, 4, 5, 6]
    assert tcp.axes == rtu.axes
    assert tcp.registers != rtu.registers
    assert open_drive(TCP, DRIVES).joints == tuple(axis.joint for axis in tcp.axes)


def test_the_axes_are_those_of_the_can_profile() -> None:
    can: Any = load_profile(DRIVES / "virtual-max100.yaml")
    modbus: Any = copy.deepcopy(TCP)
    for node, unit in zip(can["axes"], modbus["axes"], strict=True):
        assert node.pop("node") == unit.pop("unit_id")
        assert node == unit


def test_serial_silence_is_at_least_the_standards() -> None:
    def silence(baudrate: int, own: float = 0.0) -> float:
        return RtuLine(transport="rtu", device="x", baudrate=baudrate, parity="E", silence_between_frames=own).silence

    assert silence(9600) == pytest.approx(3.5 * 11 / 9600)
    assert silence(115200) == pytest.approx(1.75e-3)
    assert silence(115200, 0.01) == pytest.approx(0.01)


def test_what_a_read_takes_on_a_serial_line() -> None:
    line = RtuLine(transport="rtu", device="x", baudrate=115200, parity="N")
    assert line.read_time(120) == pytest.approx(1.75e-3 + 253 * 10 / 115200)  # 24 ms


def test_what_is_refused() -> None:
    line: Any = TCP["line"]
    axes: Any = TCP["axes"]
    bad = {
        "line": changed(TCP, line={**line, "transport": "ascii"}),
        "line.tcp.host": changed(TCP, line={key: value for key, value in line.items() if key != "host"}),
        "line.tcp.device": changed(TCP, line={**line, "device": "/dev/ttyUSB0"}),
        "must be at least twice": changed(TCP, line={**line, "watchdog": 1.0}),
        "registers: no file": changed(TCP, registers="none.yaml"),
        "axes.0.unit_id: 0 is not 1 to 247": changed(TCP, axes=[{**axes[0], "unit_id": 0}, axes[1]]),
        "axes.1.unit_id: 255 is not": changed(RTU, axes=[axes[0], {**axes[1], "unit_id": 255}]),
        "axes.0.unit_id: 248 is not": changed(TCP, axes=[{**axes[0], "unit_id": 248}]),
        "must each be different": changed(TCP, axes=[axes[0], {**axes[1], "unit_id": 1}]),
        "axes.0.node": changed(TCP, axes=[{**axes[0], "node": 1}]),
    }
    for message, profile in bad.items():
        with pytest.raises(BadProfile, match=message):
            from_profile(profile, DRIVES)


@pytest.mark.parametrize("unit", [0, 255])
def test_a_drive_that_is_addressed_directly(unit: int) -> None:
    axes: Any = TCP["axes"]
    assert parse_profile(changed(TCP, axes=[{**axes[0], "unit_id": unit}]), DRIVES).axes[0].unit_id == unit


def test_a_bad_register_map_is_a_bad_profile(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text("word_order: high_first\nsignals: {}\n")
    with pytest.raises(BadProfile, match=r"registers: .*map\.yaml: signals: missing"):
        from_profile(changed(TCP, registers=str(tmp_path / "map.yaml")), DRIVES)
