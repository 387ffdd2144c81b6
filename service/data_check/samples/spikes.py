"""Single outlier samples: spikes and drop-outs.

The deviation of a sample is computed from the median of seven samples around it, which preserves steps and ramps. Noise
of standard deviation s gives a deviation of about s. Physical effects in a drive last longer than two samples, or their
pulse is no larger than the deviations near it.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, median_filter

from service.data_check.finding import Finding, named
from service.data_check.record import AxisRecords, Record, spread
from service.model.recording import Array

Indices = NDArray[np.intp]

WIDTH = 7  # samples of the median
NEAR = 3  # samples within which a pulse of motion is visible in effort and velocity
SINGLE = float(np.finfo(np.float32).eps)  # values may have been stored in 32 bits
LONGEST = 3  # consecutive samples


def spikes(axis: AxisRecords) -> list[Finding]:
    """One finding per channel: the number of spikes, and the largest one."""
    findings: list[Finding] = []
    for name, samples in axis.channels():
        found: list[tuple[str, int, float]] = []
        for record, values in samples:
            floor = _floor(axis, record, name, values)
            off = _off(values)
            # 12.0 robust standard deviations: noise and impacts in backlash stay below
            single = _single(values, off, max(12.0 * _noise(values, off), 3 * record.steps[name], floor))
            if single.size and name != "position":
                single = single[~_moved(record, name, single)]
            if single.size:
                found.append((record.id, int(single.size), float(np.abs(off[single]).max())))
        if found:
            ids = tuple(sweep for sweep, _, _ in found)
            count, largest = sum(number for _, number, _ in found), max(size for _, _, size in found)
            findings.append(
                Finding(
                    "spikes", "wrong", axis.joint, ids, largest, None,
                    f"{axis.joint}: {name} has {count} single sample{'s' * (count > 1)} far off what is beside, by up "
                    f"to {largest:.4g} ({named(ids)}).",
                    "Look for lost frames, loose shields or faults of the encoder, and record again.",
                )
            )  # fmt: skip
    return findings


def _off(values: Array) -> Array:
    """Deviation from the median of the samples around."""
    return values - np.asarray(median_filter(values, WIDTH, mode="nearest"), dtype=float)


def _noise(values: Array, off: Array) -> float:
    """Standard deviation from values and deviations: on steep parts the median is the sample, the deviation 0."""
    return max(spread(off), spread(np.diff(values, 2)) / np.sqrt(6))


def _off_course(values: Array, first: int, last: int) -> float:
    """Largest distance from the cubic through three samples on either side; for a smooth short peak it is small."""
    around = np.r_[max(first - 3, 0) : first, last + 1 : min(last + 4, len(values))]
    course = np.polynomial.Polynomial.fit(around, values[around], min(3, len(around) - 1))
    group = np.arange(first, last + 1)
    return float(np.abs(values[group] - course(group)).max())


def _moved(record: Record, name: str, single: Indices) -> NDArray[np.bool_]:
    """Where the other of effort and velocity also has the pulse, or velocity has a kink: backlash closes, or a load
    breaks loose.
    """
    pulse = 8.0  # robust standard deviations
    other = "velocity" if name == "effort" else "effort"
    off = np.abs(_off(getattr(record, other)))
    beside = np.asarray(maximum_filter(off, 2 * NEAR + 1, mode="nearest"), dtype=float)[single]
    shown = beside > max(pulse * spread(off), 2 * record.steps[other])
    if name == "velocity":
        return shown | _way(record, single)
    bent = np.abs(np.diff(record.velocity, 2, prepend=record.velocity[0], append=record.velocity[-1]))
    kinked = np.asarray(maximum_filter(bent, 2 * NEAR + 1, mode="nearest"), dtype=float)[single]
    return shown | (kinked > max(pulse * spread(bent), 4 * record.steps["velocity"]))


def _way(record: Record, single: Indices) -> NDArray[np.bool_]:
    """Where position changes by the integral of a velocity pulse."""
    first, last = np.maximum(single - NEAR, 0), np.minimum(single + NEAR, record.count - 1)
    usual = np.asarray(median_filter(record.velocity, 2 * WIDTH, mode="nearest"), dtype=float)[single]
    gone = record.position[last] - record.position[first] - usual * (last - first) / record.rate
    off = _off(record.velocity) / record.rate
    counted, size = (np.concatenate([[0.0], np.cumsum(part)]) for part in (off, np.abs(off)))
    missed = np.abs(gone - (counted[last + 1] - counted[first]))
    return missed < (size[last + 1] - size[first]) / 2


def _floor(axis: AxisRecords, record: Record, name: str, values: Array) -> float:
    """Deviation below which a spike changes nothing."""
    if name == "effort":
        # 0.02 of rated effort: smaller spikes do not change the result
        return 0.02 * axis.axis.rated_effort
    fastest = axis.fastest or 3 * float(np.std(record.velocity))
    rounding = 3 * SINGLE * float(np.abs(values).max())
    # 0.1 of the largest commanded speed
    return max(0.1 * fastest if name == "velocity" else 5 * fastest / record.rate, rounding)


def _single(values: Array, off: Array, limit: float) -> Indices:
    """Samples beyond the limit: at most `LONGEST` consecutive ones, isolated, after which the value returns."""
    size = np.abs(off)
    beyond = np.flatnonzero(size > limit)
    if not beyond.size or limit == 0:
        return beyond[:0]
    kept: list[int] = []
    for group in np.split(beyond, np.flatnonzero(np.diff(beyond) > 1) + 1):
        first, last = int(group[0]), int(group[-1])
        near = np.concatenate([size[max(first - 11, 0) : max(first - 1, 0)], size[last + 2 : last + 12]])
        near = near[near <= limit] if near.size and np.count_nonzero(near > limit) <= 2 else near
        before, after = values[max(first - 2, 0)], values[min(last + 2, len(values) - 1)]
        returns = abs(after - before) < size[group].max() / 2
        alone = last - first < LONGEST and _off_course(values, first, last) > limit
        # 3.0 times the largest other deviation within 20 samples
        if returns and alone and (not near.size or size[group].max() > 3.0 * near.max()):
            kept.extend(range(first, last + 1))
    return np.array(kept, dtype=np.intp)
