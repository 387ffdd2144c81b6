"""One held-out sweep as an example: measured effort, and the model before and after."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.fit.equations import Equations
from service.diagnosis.rows.signals import row_samples

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Example:
    """Torques (n,) N m (N) over time (n,) s, all with the same filter."""

    sweep: str
    block: str
    time: Array
    measured: Array
    before: Array
    after: Array


def example(given: Equations, before: Array, after: Array) -> Example:
    """The sweep with the largest residual (n, rows) before."""
    tracks = given.tracks
    most = int(np.argmax(np.sum(np.where(tracks.usable, before, 0.0) ** 2, axis=1)))
    recorded = row_samples(tracks.effort.shape[1], tracks.rate)
    recorded = np.flatnonzero(tracks.inside[most][recorded])
    # 500 points
    at = recorded[:: -(-len(recorded) // 500)]
    measured = tracks.rows(tracks.effort[most : most + 1])[0, at]
    time = tracks.time[most, row_samples(tracks.effort.shape[1], tracks.rate)[at]]
    spec = tracks.specs[most]
    return Example(spec.id, spec.block, time, measured, measured - before[most, at], measured - after[most, at])
