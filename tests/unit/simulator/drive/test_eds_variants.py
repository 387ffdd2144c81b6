"""The dictionary and the three EDS files of the one virtual drive: what bus and axis make of them."""

import struct
from collections.abc import Callable
from configparser import RawConfigParser
from pathlib import Path

import numpy as np
import pytest

from simulator import Scenario, ScenarioError
from simulator.canopen.cabinet import CanopenCabinet
from simulator.canopen.pdo import Frame
from simulator.canopen.sdo import SdoServer
from simulator.drive.dictionary import AbortCode, ObjectDictionary, SdoAbort
from simulator.drive.limits import speed_unit
from simulator.drive.makers import VIRTUAL
from simulator.drive.measuring import DriveSamples
from simulator.drive.power_drive import DriveState, FaultCode
from simulator.drive.virtual_axis import VirtualAxis
from simulator.machine import LiveMachine

EDS = Path(__file__).parents[4] / "config/eds"
MINIMAL = "[DeviceInfo]\nVendorNumber=1\n\n[6040]\nParameterName=Controlword\nObjectType=7\nDataType=6\nAccessType=rw\n"


def load(name: str) -> ObjectDictionary:
    return ObjectDictionary(EDS / f"{name}.eds", 3)


def sections(name: str) -> dict[str, dict[str, str]]:
    parser = RawConfigParser()
    parser.read(EDS / f"{name}.eds")
    return {section: dict(parser[section]) for section in parser.sections()}


def objects(name: str) -> set[str]:
    return {section for section in sections(name) if section[0] in "126" and "sub" not in section}


def step(axis: VirtualAxis, cycles: int) -> np.ndarray:
    """A motor that follows exactly; the speeds, rev/s."""
    command = axis.setpoints(cycles)
    position = axis.position + np.cumsum(command) * 0.001
    zero = np.zeros(cycles)
    axis.observe(DriveSamples(zero, zero > 0, command, command, position, np.full(cycles, 0.5), zero))
    return command


def enable(dictionary: ObjectDictionary, axis: VirtualAxis, mode: int) -> None:
    dictionary.download(0x6060, 0, bytes([mode]))
    for controlword in (0x06, 0x07, 0x0F):
        axis.control(controlword)
    assert axis.state is DriveState.OPERATION_ENABLED


def test_the_variants_differ_in_what_they_are_about_alone() -> None:
    assert objects("virtual-axis") - objects("virtual-axis-no-limits") == {"6072", "607D", "607F", "6080"}
    assert objects("virtual-axis") - objects("virtual-axis-rpm") == {"2104", "2140"}
    full, rpm, bare = sections("virtual-axis"), sections("virtual-axis-rpm"), sections("virtual-axis-no-limits")
    changed = {"6083", "6084", "6085", "605A", "60A9", "1018sub2", "FileInfo", "DeviceInfo"}
    no_noise = {"2100", "2100sub0", "2100subC", "ManufacturerObjects"}
    assert {name for name in full if full[name] != rpm.get(name)} - {
        section for section in full if section[:4] in ("2104", "2140")
    } == changed | no_noise
    assert {name for name in full if full[name] != bare.get(name)} - {
        section for section in full if section[:4] in ("6072", "607D", "607F", "6080")
    } == {"FileInfo", "Comments", "OptionalObjects"}
    for content in (rpm, bare):
        for part in ("OptionalObjects", "ManufacturerObjects"):
            assert int(content[part]["supportedobjects"]) == len(content[part]) - 1


@pytest.mark.slow
def test_absent_limits_are_abort_06020000_and_hold_inside(scenario: Callable[[str], Scenario]) -> None:
    sent: list[Frame] = []
    machine = LiveMachine(scenario("rigid"), 1)
    bare, full = (
        CanopenCabinet(machine, EDS / f"{name}.eds", 1.0, sent.append)
        for name in ("virtual-axis-no-limits", "virtual-axis")
    )
    bare.boot()
    full.boot()
    node, whole = bare.nodes["joint_1"], full.nodes["joint_1"]
    for index, sub in ((0x6072, 0), (0x607F, 0), (0x6080, 0), (0x607D, 1)):
        sent.clear()
        node.receive(Frame(0x601, struct.pack("<BHB4x", 0x40, index, sub)), 0.0)
        node.receive(Frame(0x601, struct.pack("<BHBI", 0x23, index, sub, 1)), 0.0)
        answer = struct.pack("<BHBI", 0x80, index, sub, AbortCode.NO_OBJECT)
        assert [frame.data for frame in sent] == [answer, answer]
    assert node.axis.torque_limit == whole.axis.torque_limit
    assert node.axis.limits.speed == whole.axis.limits.speed
    assert node.axis.limits.profile_speed == whole.axis.limits.profile_speed
    assert node.axis.limits.window == (-2048.0, pytest.approx(2048.0))  # nothing but the encoder's range
    assert whole.axis.limits.window[1] < 200


def test_rev_per_min_everywhere() -> None:
    d = load("virtual-axis-rpm")
    assert speed_unit(d) == 60.0
    d[0x6076, 0], d[0x6080, 0], d[0x607F, 0], d[0x6081, 0] = 20_000, 3000, 3000, 600
    d[0x607D, 1], d[0x607D, 2] = -100 << 20, 100 << 20
    axis = VirtualAxis(d, 0.001, can_move=True)
    assert axis.limits.speed == 50.0
    assert axis.limits.ramp(0x6083) == pytest.approx(1000 / 60)  # as the other EDS' default
    enable(d, axis, 9)
    d.download(0x60FF, 0, struct.pack("<i", 120))
    axis.sync(0.0)
    assert step(axis, 4) == pytest.approx([0.5, 1.0, 1.5, 2.0])
    d.download(0x60FF, 0, struct.pack("<i", 120))
    axis.sync(0.004)
    step(axis, 4)
    assert d[0x606C, 0] == 120
    d.download(0x60FF, 0, struct.pack("<i", 3001))
    axis.sync(0.008)
    assert d[0x603F, 0] == FaultCode.SPEED_LIMIT


def test_its_quick_stop_always_stays() -> None:
    d = load("virtual-axis-rpm")
    for option in range(5):
        with pytest.raises(SdoAbort) as refused:
            d.download(0x605A, 0, struct.pack("<h", option))
        assert refused.value.code is AbortCode.TOO_LOW
    axis = VirtualAxis(d, 0.001, can_move=True)
    enable(d, axis, 1)
    axis.control(0x02)
    step(axis, 8)
    assert axis.state is DriveState.QUICK_STOP_ACTIVE
    assert d[0x6041, 0] & 0x400
    axis.control(0x00)
    assert axis.state is DriveState.SWITCH_ON_DISABLED


def test_no_block_upload_and_no_load_encoder() -> None:
    d = load("virtual-axis-rpm")
    request = struct.pack("<BHB", 0xA4, 0x1008, 0) + bytes([100, 0, 0, 0])
    assert SdoServer(d).handle(request) == [struct.pack("<BHBI", 0x80, 0x1008, 0, AbortCode.COMMAND)]
    assert SdoServer(load("virtual-axis")).handle(request)[0][0] == 0xC6
    d[0x6076, 0], d[0x6080, 0] = 20_000, 3000
    d[0x607D, 1], d[0x607D, 2] = -100 << 20, 100 << 20
    axis = VirtualAxis(d, 0.001, can_move=True)
    enable(d, axis, 1)
    d[0x2100, 4], d[0x2100, 5], d[0x2100, 7], d[0x2100, 8] = 60.0, 0.1, 0.1, 1
    d.download(0x2100, 1, b"\1\0")
    step(axis, 40)
    assert np.isnan(struct.unpack_from("<Ifffdd", d.upload(0x2110, 3))[5])


def test_a_dictionary_of_one_object_drives_an_axis_by_the_defaults(tmp_path: Path) -> None:
    path = tmp_path / "minimal.eds"
    path.write_text(MINIMAL)
    d = ObjectDictionary(path, 1)
    axis = VirtualAxis(d, 0.001, can_move=True)
    for controlword in (0x06, 0x07, 0x0F):
        d.download(0x6040, 0, struct.pack("<H", controlword))
    step(axis, 8)
    assert axis.state is DriveState.OPERATION_ENABLED
    assert all(d[key] is not None for key in VIRTUAL.absent)
    with pytest.raises(SdoAbort) as refused:
        d.upload(0x6041, 0)
    assert refused.value.code is AbortCode.NO_OBJECT
    axis.fail(0x7305)
    step(axis, 8)
    assert axis.state is DriveState.FAULT


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("no section at all", "not an EDS"),
        (MINIMAL.replace("DataType=6", "DataType=six"), r"\[6040\] line \d+: DataType=six"),
        (MINIMAL + "[VirtualDrive]\nBlockUpload=perhaps\n", "perhaps"),
        (
            MINIMAL + "[60A9]\nParameterName=u\nObjectType=7\nDataType=7\nAccessType=const\nDefaultValue=0x00010000\n",
            "60A9h",
        ),
    ],
)
def test_what_is_no_eds_for_this_drive_is_refused(tmp_path: Path, text: str, named: str) -> None:
    path = tmp_path / "bad.eds"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=named):
        VirtualAxis(ObjectDictionary(path, 1), 0.001, can_move=True)


@pytest.mark.parametrize(
    ("key", "data", "code"),
    [
        ((0x7000, 0), b"\0", AbortCode.NO_OBJECT),
        ((0x2101, 17), bytes(8), AbortCode.NO_SUBINDEX),
        ((0x6041, 0), b"\0\0", AbortCode.READ_ONLY),
        ((0x1000, 0), bytes(4), AbortCode.READ_ONLY),
        ((0x6040, 0), b"\0", AbortCode.TOO_SHORT),
        ((0x6040, 0), b"\0\0\0", AbortCode.TOO_LONG),
        ((0x605A, 0), struct.pack("<h", 7), AbortCode.TOO_HIGH),
        ((0x605A, 0), struct.pack("<h", -1), AbortCode.TOO_LOW),
        ((0x6072, 0), struct.pack("<H", 5001), AbortCode.TOO_HIGH),
        ((0x6085, 0), bytes(4), AbortCode.TOO_LOW),
        ((0x2100, 9), struct.pack("<H", 17), AbortCode.TOO_HIGH),
    ],
)
def test_refuses_with_the_code_of_the_standard_and_keeps_the_value(
    dictionary: ObjectDictionary, key: tuple[int, int], data: bytes, code: AbortCode
) -> None:
    known = key in dictionary
    before = dictionary[key] if known else None
    with pytest.raises(SdoAbort) as refused:
        dictionary.download(*key, data)
    assert refused.value.code is code
    assert not known or dictionary[key] == before


def test_values_go_in_and_out_as_they_lie_on_the_wire(dictionary: ObjectDictionary) -> None:
    dictionary.download(0x607A, 0, struct.pack("<i", -123456))
    assert dictionary[0x607A, 0] == -123456
    assert dictionary.upload(0x607A, 0) == struct.pack("<i", -123456)
    dictionary.download(0x2100, 4, struct.pack("<d", -17.25))
    assert dictionary[0x2100, 4] == -17.25
    assert dictionary.upload(0x1008, 0) == b"sweepid virtual axis"
    assert dictionary[0x1800, 1] == 0x40000183  # $NODEID
    assert dictionary[0x60A9, 0] == 0xFDB44700


def test_a_hook_may_refuse(dictionary: ObjectDictionary) -> None:
    def refuse(value: int) -> None:
        if value > 5:
            raise SdoAbort(AbortCode.VALUE)

    dictionary.on_download((0x1017, 0), refuse)
    dictionary.download(0x1017, 0, b"\5\0")
    with pytest.raises(SdoAbort):
        dictionary.download(0x1017, 0, b"\6\0")
    assert dictionary[0x1017, 0] == 5
    dictionary.restore()
    assert dictionary[0x1017, 0] == 0
