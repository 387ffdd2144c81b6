"""The benchmarks judge rightly, and the page of their results is what the results say."""

import numpy as np
import pytest

from tests.benchmarks import timing
from tests.benchmarks.bus_monitor import SYNC, TPDO2, Lines
from tests.benchmarks.punctuality import lateness_of
from tests.benchmarks.sweeps import Indices, count


@pytest.mark.parametrize(
    ("index", "found"),
    [
        ([0, 1, 2, 3], Indices(4, 0, 0, 0)),
        ([1, 2, 3], Indices(3, 1, 0, 0)),  # the first one, too, may be lost
        ([0, 1, 4, 5], Indices(4, 2, 0, 0)),
        ([0, 1, 1, 2], Indices(4, 0, 1, 0)),
        ([0, 2, 1, 3], Indices(4, 0, 0, 1)),
        ([], Indices(0, 0, 0, 0)),
    ],
)
def test_samples_that_are_lost_doubled_or_misordered_are_counted(index: list[int], found: Indices) -> None:
    assert count(np.array(index, dtype=np.int64)) == found
    assert found.gapless is (index in ([0, 1, 2, 3], []))


def test_lateness_is_told_against_the_grid_of_most_cycles() -> None:
    sync = np.arange(200) * 0.004
    sync[50] += 0.001
    sync[120] += 0.0035
    late, missed = lateness_of(np.asarray(sync + 1e9, np.float64), 0.004)
    assert np.flatnonzero(late > 1e-4).tolist() == [49, 119]  # of each SYNC but the first
    assert late[[49, 119]] == pytest.approx([0.001, 0.0035], abs=2e-6)
    assert missed == 0


def test_deadlines_that_were_left_out_are_counted_and_shift_nothing() -> None:
    deadlines = np.delete(np.arange(200), [51, 52]) * 0.004
    deadlines[50] += 0.0101  # so late that two more deadlines passed
    late, missed = lateness_of(np.asarray(deadlines + 1e9, np.float64), 0.004)
    assert missed == 2
    assert late.max() == pytest.approx(0.0101, abs=2e-6)
    assert np.median(late) < 1e-5


def test_lines_of_a_socketcand_server_may_be_cut_anywhere() -> None:
    text = (
        b"< frame 080 12.500000  >< frame 181 12.6 0102 >< frame 281 13.250000 0000000007000000 >< frame 701 14.0 05 >"
    )
    for cut in range(len(text)):
        lines = Lines()
        assert lines.take(text[:cut]) + lines.take(text[cut:]) == [(12.5, SYNC, 0), (13.25, TPDO2 + 1, 7)]


def test_the_page_is_what_the_results_say() -> None:
    assert timing.PAGE.read_text("utf-8") == timing.page(), "run: python -m tests.benchmarks.timing write"
