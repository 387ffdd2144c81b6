"""Measurement errors of each 1 ms sample: noise of current, speed and encoders, and quantisation of the torque."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simulator.plant import Samples
from simulator.scenario import Measurement

Array = NDArray[np.float64]


def measure(
    samples: Samples, measurement: Measurement, rated_effort: Array, random: Sequence[np.random.Generator]
) -> Samples:
    """Samples as reported by the drive; `rated_effort` (rows,) N m, one random stream per row."""

    def noisy(values: Array, rms: float | Array) -> Array:
        if not np.any(rms):
            return values
        noise = np.empty_like(values)
        for row, stream in enumerate(random):
            noise[:, row] = stream.standard_normal(len(values))
        return values + rms * noise

    effort = noisy(samples.effort, measurement.effort_noise * rated_effort)
    if measurement.effort_resolution:
        step = measurement.effort_resolution * rated_effort
        effort = np.round(effort / step) * step
    return replace(
        samples,
        effort=effort,
        velocity=noisy(samples.velocity, measurement.velocity_noise),
        position=noisy(samples.position, measurement.position_noise),
        load_position=noisy(samples.load_position, measurement.load_position_noise),
        load_velocity=noisy(samples.load_velocity, measurement.load_velocity_noise),
    )
