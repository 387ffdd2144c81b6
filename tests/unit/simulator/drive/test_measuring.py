import struct
from collections.abc import Callable

import numpy as np
import pytest

from simulator.drive.axis import Axis
from simulator.drive.dictionary import Abort, AbortCode, Dictionary
from simulator.drive.excitation import Sweep
from simulator.drive.measuring import Rejection, Run, Samples, Trace
from simulator.drive.states import State

Turn = Callable[..., np.ndarray]
Enable = Callable[[int], None]
SWEEP = Sweep(offset=60.0, ramp=0.5, settle=1.0, period=1.0, periods=2, sines=((2.0, 6.0, 0.3), (5.0, 12.0, -1.0)))
RECORD = struct.Struct("<Ifffdd")


def parameters(dictionary: Dictionary, **changed: float) -> None:
    d = dictionary
    d[0x2100, 4], d[0x2100, 5], d[0x2100, 6], d[0x2100, 7] = 60.0, 0.5, 1.0, 1.0
    d[0x2100, 8], d[0x2100, 9], d[0x2100, 0x0A] = 2, 2, 4
    for sub, sine in enumerate(SWEEP.sines, 1):
        for index, value in zip((0x2101, 0x2102, 0x2103), sine, strict=True):
            d[index, sub] = value
    for name, value in changed.items():
        d[0x2100, {"offset": 4, "ramp": 5, "period": 7}[name]] = value


def command(dictionary: Dictionary, value: int) -> None:
    dictionary.download(0x2100, 1, struct.pack("<H", value))


def test_set_points_by_the_formula() -> None:
    speed = SWEEP.setpoints(0.001)
    assert len(speed) == 4000
    t = 2.345 - 1.5
    by_hand = 60 + 6 * np.sin(2 * np.pi * 2 * t + 0.3) + 12 * np.sin(2 * np.pi * 5 * t - 1)
    assert speed[2344] * 60 == pytest.approx(by_hand)
    assert speed[-1] == 0.0
    t = 0.25 - 1.5
    by_hand = 60 + 6 * np.sin(2 * np.pi * 2 * t + 0.3) + 12 * np.sin(2 * np.pi * 5 * t - 1)
    assert speed[249] * 60 == pytest.approx(by_hand / 2)  # half-way up the raised cosine
    assert np.abs(speed).max() * 60 <= SWEEP.peak


def test_the_trace_keeps_block_means() -> None:
    trace = Trace(stride=4, capacity=3, cycle=0.001)
    rows = np.arange(14.0)
    for part in (rows[:3], rows[3:9], rows[9:]):
        trace.extend(Samples(part, part > 99, part / 60, -part / 60, 2 * part, np.full_like(part, np.nan), part))
    assert trace.count == 3  # the last two rows are no whole block, and it is full
    page = trace.page(1, 512)
    assert [RECORD.unpack_from(page, at)[:5] for at in (0, 32)] == [
        (1, 5.5, 5.5, -5.5, 11.0),
        (2, 9.5, 9.5, -9.5, 19.0),
    ]
    assert np.isnan(RECORD.unpack_from(page, 0)[5])
    assert trace.page(0, 1) + trace.page(1, 2) == trace.page(0, 3)
    assert trace.page(3, 5) == b""


def test_a_run_from_start_to_page(dictionary: Dictionary, axis: Axis, turn: Turn, enable: Enable) -> None:
    parameters(dictionary)
    enable(1)
    command(dictionary, 1)
    assert dictionary[0x2100, 2] == Run.RUNNING
    with pytest.raises(Abort) as twice:
        command(dictionary, 1)
    assert twice.value.code is AbortCode.STATE
    speeds = turn(2000, 10)
    assert speeds == pytest.approx(SWEEP.setpoints(0.001)[:2000])
    assert dictionary[0x2100, 0x0B] == 500
    assert len(dictionary.upload(0x2110, 3)) == 500 * 32  # while it runs
    turn(2000, 10)
    assert dictionary[0x2100, 2] == Run.DONE
    assert dictionary[0x2100, 0x0B] == 1000
    assert not axis.moving
    dictionary[0x2110, 1], dictionary[0x2110, 2] = 998, 512
    page = dictionary.upload(0x2110, 3)
    assert [RECORD.unpack_from(page, at)[0] for at in (0, 32)] == [998, 999]
    dictionary[0x2110, 1] = 1000
    with pytest.raises(Abort) as empty:
        dictionary.upload(0x2110, 3)
    assert empty.value.code is AbortCode.NO_DATA


@pytest.mark.parametrize(
    ("changed", "enabled", "reason"),
    [
        ({}, False, Rejection.NOT_ENABLED),
        ({"offset": 3000.0}, True, Rejection.SPEED),
        ({"offset": 2900.0}, True, Rejection.POSITION_WINDOW),  # 50 rev/s for 3 s
        ({"ramp": 0.0}, True, Rejection.PARAMETERS),
        ({"period": float("nan")}, True, Rejection.PARAMETERS),
        ({"period": 1e9}, True, Rejection.PARAMETERS),
    ],
)
def test_rejections(
    dictionary: Dictionary, axis: Axis, enable: Enable, changed: dict[str, float], enabled: bool, reason: Rejection
) -> None:
    parameters(dictionary, **changed)
    if enabled:
        enable(1)
    command(dictionary, 1)
    assert dictionary[0x2100, 2] == Run.REJECTED
    assert dictionary[0x2100, 3] == reason
    assert axis.setpoints(8) == pytest.approx(np.zeros(8))


def test_abort_brings_it_to_standstill_and_keeps_the_trace(
    dictionary: Dictionary, axis: Axis, turn: Turn, enable: Enable
) -> None:
    parameters(dictionary)
    enable(1)
    command(dictionary, 1)
    turn(1600)
    before = dictionary.upload(0x2110, 3)
    command(dictionary, 2)
    speeds = turn(80)
    assert np.all(np.diff(np.abs(speeds)) <= 1e-12)
    assert speeds[-1] == pytest.approx(0.0)
    assert dictionary[0x2100, 2] == Run.ABORTED
    assert axis.state is State.OPERATION_ENABLED
    assert dictionary.upload(0x2110, 3) == before
    command(dictionary, 1)
    assert dictionary[0x2100, 2] == Run.RUNNING


@pytest.mark.parametrize("end", ["quick stop", "fault", "torque off"])
def test_anything_that_ends_the_operation_ends_the_run(
    dictionary: Dictionary, axis: Axis, turn: Turn, enable: Enable, end: str
) -> None:
    parameters(dictionary)
    enable(1)
    command(dictionary, 1)
    turn(1600)
    {"quick stop": axis.quick_stop, "fault": lambda: axis.fail(0x7305), "torque off": axis.disable_voltage}[end]()
    turn(200)
    assert dictionary[0x2100, 2] == Run.ABORTED
    assert not axis.energised
    assert turn(80) == pytest.approx(np.zeros(80))
