"""A streamed sweep whose host fails in itself: the axes are told to stop, and the consumer is told why."""

import itertools
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures.thread import _WorkItem  # pyright: ignore[reportPrivateUsage]  # there is no other way between a result and the end of its thread
from types import FrameType

import pytest

from drivers.canopen import host_sweep
from drivers.canopen.bcm import KernelRefused
from drivers.canopen.host_sweep import HostSweep
from drivers.canopen.streamed_axis import Ending, StreamedAxis
from drivers.ports import SampleBlock
from tests.unit.drivers.small_servo import eventually
from tests.unit.drivers.streaming_bench import OFF, Drive, bench, run_to_end

pytestmark = pytest.mark.slow


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


async def test_a_stop_that_came_first_is_a_stop_though_a_drive_says_nothing() -> None:
    stop = threading.Event()
    stop.set()
    async with bench(Drive(1, mangle=lambda _, __: [])) as on:
        run = on.start(stop=stop)
        await run_to_end(run)
        assert run.ending is Ending.STOPPED
        obeyed = on.cabinet.drives[1].obeyed
        await eventually(lambda: (0x00, 0) in obeyed)
        assert {controlword for controlword, _ in obeyed} == {0x02, 0x00}


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
