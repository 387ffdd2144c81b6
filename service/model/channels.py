r"""Corrects the channels of a recording: removes the filters and delays of the drive.

For a channel with delay and smoothing in the drive, Y = e^{-s tau} / (1 + s T) X, the original is

    x(t) = y(t + tau) + T y'(t + tau).

Both are taken from the polynomial through the 13 samples around t + tau (Lagrange), so the result is one short filter
with weights w_k over offsets k = -6 ... 6 from the sample nearest to t + tau, exact for polynomials of degree 12:

        sum_k w_k k^j = f^j + (T/Ts) j f^(j-1),   j = 0 ... 12,   f = tau/Ts - (nearest integer), Ts sample period.

Below 20 Hz at 250 Hz its error is below 1e-6. White noise of a channel is amplified by `noise_gain`, 1.3 to 1.8 T/Ts if
the time constant is longer than a sample; at a line it is amplified no more than the signal. Samples at the ends with
missing neighbours are removed from all columns.
"""

from dataclasses import fields, replace

import numpy as np

from drivers.ports import ChannelTiming
from service import BadInput
from service.model.arrays import Array
from service.model.recording import Recording

HALF = 6  # samples on either side


def align(recording: Recording, timing: ChannelTiming) -> Recording:
    """Effort and velocity of each row at the time of its position; the same object if there is nothing to correct.

    Remaining samples keep their `time`, so it no longer starts at 0. BadInput if the recording is too short.
    """
    if timing == ChannelTiming():
        return recording
    count = len(recording.time)
    rate = (count - 1) / float(recording.time[-1] - recording.time[0])
    first, last = 0, count
    filters: dict[str, tuple[int, Array]] = {}
    for name, delay, smoothing in (
        ("effort", timing.effort_delay, timing.effort_smoothing),
        ("velocity", timing.velocity_delay, timing.velocity_smoothing),
    ):
        if delay or smoothing:
            nearest, weights = _filter(delay * rate, smoothing * rate)
            filters[name] = nearest, weights
            first, last = max(first, HALF - nearest), min(last, count - HALF - nearest)
    if last - first < 2:
        raise BadInput("recording", f"{count} samples are too few to correct delay and smoothing of its channels")
    kept = {
        field.name: column[first:last]
        for field in fields(recording)
        if (column := getattr(recording, field.name)) is not None
    }
    for name, (nearest, weights) in filters.items():
        part = getattr(recording, name)[first + nearest - HALF : last + nearest + HALF]
        kept[name] = np.convolve(part, weights[::-1], mode="valid")
    return replace(recording, **kept)


def noise_gain(delay: float, smoothing: float, rate: float) -> float:
    """Factor of the standard deviation of white noise by the correction of a channel (s, s), at `rate` Hz."""
    if not (delay or smoothing):
        return 1.0
    return float(np.linalg.norm(_filter(delay * rate, smoothing * rate)[1]))


def _filter(delay: float, smoothing: float) -> tuple[int, Array]:
    """The sample nearest to t + tau and the weights of those around it; delay and smoothing in samples."""
    nearest = round(delay)
    at = (delay - nearest) / HALF  # in units with offsets from -1 to 1: well-conditioned
    power = np.arange(2 * HALF + 1)
    offsets = np.linspace(-1.0, 1.0, 2 * HALF + 1)
    slope = np.zeros_like(offsets)
    slope[1:] = power[1:] * at ** power[:-1]
    wanted = at**power + smoothing / HALF * slope
    return nearest, np.linalg.solve(offsets ** power[:, None], wanted).astype(np.float64)
