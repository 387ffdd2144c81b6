"""Host-streamed sweeps of small drives that count no samples: what is lost is a gap, and silence an end."""

from collections.abc import Callable

import numpy as np
import pytest

from drivers.canopen.streamed_axis import Ending
from drivers.ports import SampleBlock
from tests.unit.drivers.streaming_bench import PERIOD, Drive, Frame, bench, run_to_end

pytestmark = pytest.mark.slow

SAMPLES = round(0.5 / PERIOD) + 1
WAITS = 6.0  # s, a third of it for a late answer: an overloaded computer is no lost frame


def joined(blocks: list[SampleBlock]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Index, velocity and its set-point."""
    return tuple(
        np.concatenate([getattr(b, name) for b in blocks]) for name in ("index", "velocity", "velocity_setpoint")
    )  # pyright: ignore[reportReturnType]


def losing(which: tuple[int, ...], numbers: range) -> Callable[[int, list[Frame]], list[Frame]]:
    """A drive whose TPDOs (0, 1) do not answer these SYNCs."""
    return lambda number, answer: [each for k, each in enumerate(answer) if number not in numbers or k not in which]


async def test_every_sync_is_a_sample_of_the_set_point_reached_there() -> None:
    async with bench(Drive(1, counts=False), Drive(2, counts=False), silence=WAITS) as on:
        run = on.start()
        blocks = await run_to_end(run)
        assert (run.ending, run.reason) == (Ending.COMPLETED, "")
        for joint in ("joint_1", "joint_2"):
            index, velocity, asked = joined([block for block in blocks if block.joint == joint])
            assert index.tolist() == list(range(SAMPLES))
            assert velocity == pytest.approx(asked, abs=0.5001e-3)


@pytest.mark.parametrize("which", [(0,), (1,), (0, 1)])
async def test_a_lost_answer_is_a_gap_and_the_next_sample_is_right(which: tuple[int, ...]) -> None:
    async with bench(Drive(1, counts=False, mangle=losing(which, range(40, 41))), silence=WAITS) as on:
        run = on.start()
        index, velocity, asked = joined(await run_to_end(run))
        assert run.ending is Ending.COMPLETED
        assert len(set(range(SAMPLES)) - set(index.tolist())) == 1  # the host waited: nothing is late any more
        assert velocity == pytest.approx(asked, abs=0.5001e-3)


async def test_a_drive_that_answers_nothing_more_is_silent_within_its_time() -> None:
    drive = Drive(1, counts=False, mangle=losing((0, 1), range(40, 10**6)))
    async with bench(drive, silence=0.3) as on:
        run = on.start(on.request(1, periods=50))
        await run_to_end(run)
        assert run.ending is Ending.SILENT
        cycles = round(0.3 / PERIOD)
        assert len(drive.obeyed) < 40 + cycles + 600  # the stop sequence's, not the sweep's 2500
