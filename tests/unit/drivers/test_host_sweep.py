"""Host-streamed sweeps of small drives over python-can's virtual bus: one clock, one end, nothing mixed or missed."""

import ctypes
import itertools
import re
import struct
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures.thread import _WorkItem  # pyright: ignore[reportPrivateUsage]  # there is no other way between a result and the end of its thread
from types import FrameType
from typing import Any

import numpy as np
import pytest

from drivers.canopen import frames, host_sweep
from drivers.canopen.bus import KernelRefused
from drivers.canopen.host_sweep import HostSweep
from drivers.canopen.streamed_axis import Ending, StreamedAxis
from drivers.contract.bench import eventually
from drivers.errors import CommunicationLost
from drivers.ports import SampleBlock
from tests.unit.drivers.streaming_bench import ENABLED, OFF, PERIOD, SWITCHED_ON, Bench, Drive, Frame, bench, run_to_end

pytestmark = pytest.mark.slow

SAMPLES = round(0.5 / PERIOD) + 1


def of(blocks: list[SampleBlock], joint: str) -> SampleBlock:
    mine = [block for block in blocks if block.joint == joint]
    columns = ("index", "time", "effort", "velocity", "position", "velocity_setpoint")
    return SampleBlock(joint, *(np.concatenate([getattr(block, name) for block in mine]) for name in columns))


def never_told_to_enable(drive: Drive) -> bool:
    return not any(controlword & 0x08 for controlword, _ in drive.obeyed)


async def test_three_axes_run_on_one_clock_each_as_long_as_its_sweep() -> None:
    async with bench(Drive(1), Drive(2), Drive(3)) as on:
        run = on.start(on.request(1), on.request(2), on.request(3, periods=2))
        blocks = await run_to_end(run)
        assert (run.ending, run.reason, run.joint) == (Ending.COMPLETED, "", "")
        for node, count in ((1, SAMPLES), (2, SAMPLES), (3, SAMPLES + round(0.2 / PERIOD))):
            samples = of(blocks, f"joint_{node}")
            assert samples.index.tolist() == list(range(count))
            assert samples.time == pytest.approx(np.arange(count) * PERIOD)
            # what was asked for SYNC k is what the drive shows there, to half a raw unit
            assert samples.velocity == pytest.approx(samples.velocity_setpoint, abs=0.5001e-3)
            assert np.max(samples.velocity) > 0.5 * node
        heard = "".join({0x80: "S", 0x201: "1", 0x202: "2", 0x203: "3"}[each] for each in on.cabinet.heard)
        opening = len(heard) - len(heard.lstrip("S"))
        assert opening >= 1
        assert heard[opening:] == "123S" * (heard.count("S") - opening)
        timing = run.timing()
        assert timing.source == "thread"
        assert timing.cycles >= SAMPLES
        assert 0.0 <= timing.median_lateness <= timing.worst_lateness


# faults, a counter that stands: tests/virtual_time/test_drive_port.py
MISHAPS: dict[str, tuple[Callable[[Bench, Drive], object], Ending, str]] = {
    "leaves its envelope": (
        lambda _, drive: setattr(drive, "offset", 60 * 10**6),
        Ending.LEFT_ENVELOPE,
        "position .* is outside -50 to 50 rad",
    ),
    "is silent": (
        lambda _, drive: setattr(drive, "mangle", lambda _, __: []),
        Ending.SILENT,
        "no sample for 101 cycles of 4 ms",
    ),
    "counts double": (
        lambda _, drive: setattr(drive, "counter", drive.counter + 20),
        Ending.MISCOUNTED,
        "sample counter is [0-9]+ ahead of SYNC",
    ),
    "missed a SYNC": (
        lambda _, drive: setattr(drive, "counter", drive.counter - 1),
        Ending.MISCOUNTED,
        # 1, and the SYNCs whose answers are still on their way
        "sample counter is [0-9]+ behind SYNC",
    ),
    "its counter jumps": (
        lambda _, drive: setattr(drive, "counter", drive.counter + 10**6),
        Ending.SILENT,
        "no sample for 101 cycles of 4 ms",
    ),
}


@pytest.mark.parametrize(("mishap", "ending", "reason"), MISHAPS.values(), ids=MISHAPS)
async def test_whatever_ends_one_axis_ends_all(
    mishap: Callable[[Bench, Drive], object], ending: Ending, reason: str
) -> None:
    async with bench(Drive(1), Drive(2), Drive(3)) as on:
        periods = 2 if "behind" in reason else 300  # a counter is behind for certain once all answers have come
        run = on.start(*(on.request(node, periods=periods) for node in (1, 2, 3)))
        done: list[SampleBlock] = []

        def once(block: SampleBlock) -> None:
            done.append(block)
            if len(done) == 1:
                mishap(on, on.cabinet.drives[2])

        await run_to_end(run, once)
        assert (run.ending, run.joint) == (ending, "joint_2")
        assert run.reason.startswith("joint_2 (node 2): ")
        assert re.search(reason, run.reason), run.reason
        for drive in on.cabinet.drives.values():
            assert drive.statusword == OFF
            await eventually(lambda drive=drive: drive.obeyed[-1] == (0x00, 0))  # on its way to the drive


async def test_a_slow_drive_that_counts_has_few_syncs_to_catch_up_with() -> None:
    """Its stop and its heartbeats would wait behind all of them."""
    ahead: list[int] = []

    def slow(k: int, answer: list[Frame]) -> list[Frame]:
        time.sleep(3 * PERIOD)
        ahead.append(run.timing().cycles - k)
        return answer

    async with bench(Drive(1, mangle=slow)) as on:
        run = on.start()
        blocks = await run_to_end(run)
    assert (run.ending, run.reason) == (Ending.COMPLETED, "")
    assert of(blocks, "joint_1").index.tolist() == list(range(SAMPLES))
    assert 2 < max(ahead) <= StreamedAxis.most_ahead / PERIOD + 2


@pytest.mark.parametrize("state", [SWITCHED_ON, OFF, 0x21, 0x07, 0x08, 0x00, 0xFFFF])
async def test_a_drive_that_is_not_enabled_is_never_told_to_enable(state: int) -> None:
    async with bench(Drive(1), Drive(2, statusword=state)) as on:
        run = on.start()
        assert await run_to_end(run) == []
        assert (run.ending, run.joint) == (Ending.LEFT_STATE, "joint_2")
        assert on.cabinet.drives[2].statusword == state
        assert all(never_told_to_enable(drive) for drive in on.cabinet.drives.values())


def hold_up(seconds: float) -> None:
    """A busy moment of the host: nothing of this process runs, as usleep is called without giving away the GIL."""
    ctypes.PyDLL(None).usleep(round(seconds * 1e6))


async def late_once(on: Bench, seconds: float) -> HostSweep:
    run = on.start(on.request(1, periods=3))
    held = threading.Event()

    def once(_: SampleBlock) -> None:
        if not held.is_set():
            held.set()
            hold_up(seconds)

    await run_to_end(run, once)
    return run


async def test_a_late_host_is_counted_and_goes_on_where_the_profile_allows_it() -> None:
    async with bench(Drive(1)) as on:
        run = await late_once(on, 0.1)
        assert run.ending is Ending.COMPLETED
        assert run.timing().missed >= 20
        assert run.timing().worst_lateness >= 0.08


async def test_a_stall_while_the_axis_comes_to_standstill_is_not_held_against_the_axis() -> None:
    def stall(k: int, answer: list[Frame]) -> list[Frame]:
        if k == SAMPLES + 2:  # the sweep is over, and the host waits for standstill
            hold_up(HostSweep.standstill_timeout + 0.5)
        return answer

    async with bench(Drive(1, mangle=stall)) as on:
        run = on.start()
        samples = of(await run_to_end(run), "joint_1")
        assert (run.ending, run.reason) == (Ending.COMPLETED, "")
        assert samples.index.tolist() == list(range(SAMPLES))
        assert run.timing().worst_lateness > HostSweep.standstill_timeout


async def test_an_axis_that_does_not_come_to_standstill_is_stopped() -> None:
    def drift(_: int, answer: list[Frame]) -> list[Frame]:
        statusword, velocity, torque = struct.unpack("<Hih", answer[0][1])
        return [(answer[0][0], struct.pack("<Hih", statusword, velocity + 2, torque)), answer[1]]  # 1 is standstill

    async with bench(Drive(1), Drive(2, mangle=drift)) as on:
        run = on.start()
        await run_to_end(run)
        assert (run.ending, run.joint) == (Ending.NO_STANDSTILL, "joint_2")
        assert run.reason == "joint_2 (node 2): is not at standstill 3 s after its sweep"
        assert run.timing().cycles >= SAMPLES + HostSweep.standstill_timeout / PERIOD
        assert {drive.statusword for drive in on.cabinet.drives.values()} == {OFF}


@pytest.mark.parametrize(
    ("limits", "seconds", "reason"),
    [
        ({"missed_cycles": 20, "host_timeout": 10.0}, 0.2, "deadlines of 4 ms were missed, 20 are allowed; the worst"),
        ({"host_timeout": 0.25}, 0.5, "s late, 0.25 s are the limit"),
    ],
    ids=["many", "one very late"],
)
async def test_a_host_that_is_too_late_ends_the_sweep(limits: dict[str, Any], seconds: float, reason: str) -> None:
    async with bench(Drive(1), **limits) as on:
        run = await late_once(on, seconds)
        assert run.ending is Ending.LATE
        assert reason in run.reason
        assert on.cabinet.drives[1].statusword == OFF


async def test_bus_off_ends_it_at_once() -> None:
    async with bench(Drive(1)) as on:
        run = on.start(on.request(1, periods=300))
        with pytest.raises(CommunicationLost, match=r"bus-off; controller bus-off \(transmit errors 248"):
            await run_to_end(run, lambda _: on.cabinet.say(0x040, bytes([0, 0, 0, 0, 0, 0, 248, 0]), error=True))
        with pytest.raises(CommunicationLost, match="bus-off"):
            on.bus.send(frames.Cob.SYNC, b"")
        assert on.cabinet.drives[1].statusword == ENABLED  # its own watch of SYNC must stop it


async def test_an_error_that_nobody_thought_of_stops_the_axes_before_the_consumer_hears_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """And the consumer gets that error, not the end of a sweep that it would take the mode from while it moves."""
    hand_over, samples = StreamedAxis.block, itertools.count()

    def fail(self: StreamedAxis, at_least: int) -> SampleBlock | None:
        if at_least > 1 and next(samples) > 80:
            raise ArithmeticError("unforeseen")
        return hand_over(self, at_least)

    async with bench(Drive(1), Drive(2)) as on:
        monkeypatch.setattr(StreamedAxis, "block", fail)
        run = on.start(on.request(1, periods=300), on.request(2, periods=300))
        await run.over()
        with pytest.raises(ArithmeticError, match="unforeseen"):
            await run_to_end(run)
        drives = list(on.cabinet.drives.values())
        await eventually(lambda: all(drive.statusword == OFF for drive in drives))
        assert [drive.obeyed[-1] for drive in drives] == [(0x02, 0)] * 2


async def test_a_kernel_that_takes_no_more_set_points_is_no_dead_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    class Kernel:
        """Refuses the first topping up, as one without memory does."""

        def __init__(self, *_: object) -> None: ...

        def begin(self) -> None: ...

        def top_up(self, sent: int) -> None:
            raise KernelRefused("vcan0: the kernel refused the set-points: no buffer space available")

        def close(self) -> None: ...

    async with bench(Drive(1), Drive(2)) as on:
        monkeypatch.setattr(host_sweep, "set_point_source", lambda *_, **__: "bcm")
        monkeypatch.setattr(host_sweep, "KernelStream", Kernel)
        run = on.start(on.request(1, periods=300), on.request(2, periods=300))
        await run_to_end(run)
        assert run.ending is Ending.NOT_SENT
        assert "no buffer space" in run.reason
        assert [drive.statusword for drive in on.cabinet.drives.values()] == [OFF, OFF]


@pytest.mark.parametrize("until_end", [HostSweep.over, HostSweep.finished])
async def test_once_over_its_thread_is_gone(
    until_end: Callable[[HostSweep], Awaitable[None]], slow_to_end: Callable[[], None]
) -> None:
    """A machine that was closed leaves no thread behind, on a busy computer either."""
    stop = threading.Event()
    stop.set()
    async with bench(Drive(1)) as on:
        slow_to_end()
        run = on.start(stop=stop)
        await until_end(run)
        assert not [thread for thread in threading.enumerate() if thread.name.startswith("can-stream")]


@pytest.fixture
def slow_to_end() -> Iterator[Callable[[], None]]:
    """From its call on, a pool's thread pauses between telling a result and whatever it does next."""

    def pause(frame: FrameType, event: str, _: object) -> None:
        if event == "return" and frame.f_code is _WorkItem.run.__code__:
            time.sleep(0.1)

    yield lambda: threading.setprofile(pause)
    threading.setprofile(None)
