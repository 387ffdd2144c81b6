"""From the time stamps of a bus monitor to how punctual SYNC and samples were."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.benchmarks.bus_monitor import SYNC
from tests.benchmarks.sweeps import Run

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Spread:
    """s."""

    median: float
    p99: float
    worst: float


@dataclass(frozen=True)
class Punctuality:
    """Of all host-streamed runs: how late SYNC was, how far SYNC to SYNC was off the period, how long after a SYNC the
    sample frames came that it caused. `missed`: deadlines that passed without a SYNC of their own."""

    cycles: int
    missed: int
    lateness: Spread
    interval: Spread
    answer: Spread


def punctuality(frames: NDArray[np.void], runs: Sequence[Run], period: float) -> Punctuality:
    """`frames` as `bus_monitor.FRAME`; every run must have some."""
    missed = 0
    lateness: list[Array] = []
    interval: list[Array] = []
    answer: list[Array] = []
    for run in runs:
        mine = frames[(frames["time"] >= run.begin) & (frames["time"] <= run.end)]
        sync = mine["time"][mine["id"] == SYNC]
        samples = mine["time"][mine["id"] != SYNC]
        late, left_out = lateness_of(sync, period)
        missed += left_out
        lateness.append(late)
        interval.append(np.abs(np.diff(sync) - period))
        cause = np.searchsorted(sync, samples, side="right") - 1
        answer.append((samples - sync[cause])[cause >= 0])
    return Punctuality(
        cycles=sum(map(len, interval)) + len(runs),
        missed=missed,
        lateness=_spread(lateness),
        interval=_spread(interval),
        answer=_spread(answer),
    )


def lateness_of(sync: Array, period: float) -> tuple[Array, int]:
    """How late each SYNC but the first was (n - 1,), s, and how many deadlines were left out.

    The deadlines are a grid of `period`, placed where most frames are; a frame's own is the first one after the frame
    before, as the sender leaves out what has passed.
    """
    phase = np.mod(sync - sync[0], period)
    counts, edges = np.histogram(phase, 64, (0.0, period))
    peak = float(edges[np.argmax(counts)])
    off = np.mod(phase - peak + period / 2, period) - period / 2
    first = float(sync[0]) + peak + float(np.quantile(off[np.abs(off) < period / 4], 0.05))
    number = np.floor((sync - first) / period + 0.02)  # of the last deadline at or before each frame
    late = sync[1:] - (first + (number[:-1] + 1) * period)
    return np.maximum(late, 0.0), int(number[-2] - number[0]) - (len(sync) - 2)


def _spread(parts: Sequence[Array]) -> Spread:
    values = np.concatenate(parts)
    return Spread(float(np.median(values)), float(np.quantile(values, 0.99)), float(values.max()))
