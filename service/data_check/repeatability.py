"""Repeatability: two sweeps back to back that differ by more than the sensor noise.

The difference of two repeats contains only noise if all causes of motion repeat. Below `BAND`'s end, its spectral
density is compared with that of standstill records or, without these, with its own density between 25 and 100 Hz.
Sensor noise that increases towards low frequencies stays below three times that. Single pairs count if they occur in
most kinds of motion, and in none more often than by chance: vibration of the machine does not depend on the motion, but
a load that moves within the backlash of its gear does. The diagnosis cannot name such a cause, because it
takes the difference for noise: floor vibration, stick-slip, a loose cable.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from service.data_check.finding import DataFinding, named
from service.data_check.probabilities import hypergeometric_tail
from service.data_check.record import AxisRecords, Record
from service.model import Array, Complex, Mask

BAND = (1.0, 20.0)  # Hz
OWN = (25.0, 100.0)  # Hz, noise of the sensor
OFTEN = 4.0  # times the density of the noise, median of all pairs
SELDOM = 8.0  # times the density of the noise, in single pairs


@dataclass(frozen=True)
class Pair:
    """Difference of two repeats (n,), scaled to one; `low` and `high`: its spectral densities in both bands."""

    first: Record
    second: Record
    level: float  # difference of their means, N m (N)
    difference: Array
    low: float
    high: float

    @property
    def rounding(self) -> float:
        """Density of the quantisation noise of effort, uniform up to half the sample rate; a hold may show none."""
        return max(one.steps["effort"] for one in (self.first, self.second)) / np.sqrt(6 * len(self.difference))

    @property
    def excess(self) -> float:
        """RMS below the end of `BAND`, N m (N)."""
        width = (BAND[1] - BAND[0]) * len(self.difference) / self.first.rate
        return self.low * float(np.sqrt(width))


def repeatability(axis: AxisRecords) -> list[DataFinding]:
    """One warning, with the motions and the frequency."""
    least = 0.001  # of rated effort, RMS: one step of typical drives
    found = _pairs(axis)
    if (level := _level(axis, found)) is not None:
        return [level]
    pairs, holds = [pair for pair in found if not _still(pair)], [pair.low for pair in found if _still(pair)]
    if not pairs:
        return []
    noise = [max(float(np.median(holds)) if holds else pair.high, pair.rounding, 1e-12) for pair in pairs]
    factor = np.array([pair.low / own for pair, own in zip(pairs, noise, strict=True)])
    seen = np.array([pair.excess for pair in pairs]) > least * axis.axis.rated_effort
    often = float(np.median(factor)) > OFTEN and 2 * np.count_nonzero(seen) > len(pairs)
    single = (factor > SELDOM) & seen
    # 0.05 of all pairs, and at least two, must then show it
    if not often and (np.count_nonzero(single) < max(2, 0.05 * len(pairs)) or not _anywhere(pairs, single)):
        return []
    shown = [pair for pair, yes in zip(pairs, (factor > OFTEN) & seen if often else single, strict=True) if yes]
    ids = tuple(dict.fromkeys(record.id for pair in shown for record in (pair.first, pair.second)))
    value = float(np.median([pair.excess for pair in shown]))
    worst = float(np.median(factor[seen])) if often else float(factor.max())
    return [
        DataFinding(
            "not_repeatable", "warning", axis.joint, ids, value, least * axis.axis.rated_effort,
            f"{axis.joint}: repeats differ by {value:.3g} {axis.unit} (RMS below {BAND[1]:g} Hz), {worst:.2g} times "
            f"the sensor's noise, {_how(shown)} ({len(shown)} of {len(pairs)} pairs, {named(ids)}).",
            "Look for what shakes the floor, for stick-slip and loose cables; what does not repeat is taken for noise.",
        )
    ]  # fmt: skip


def _level(axis: AxisRecords, found: Sequence[Pair]) -> DataFinding | None:
    """A mean effort that differs in the second repeat, in half of the pairs: more drag, an offset, another load."""
    pairs, holds = [pair for pair in found if not _still(pair)], [pair.low for pair in found if _still(pair)]
    # effort in another unit cannot be compared with the rated effort
    largest = max((float(np.abs(one.effort).max()) for pair in pairs for one in (pair.first, pair.second)), default=0.0)
    # 0.005 of rated effort: five steps of typical drives; warming friction changes less in ten seconds
    limit = max(0.005 * max(axis.axis.rated_effort, largest), SELDOM * max(holds, default=0.0))
    value = float(np.median([pair.level for pair in pairs])) if pairs else 0.0
    if value <= limit:
        return None
    ids = tuple(dict.fromkeys(one.id for pair in pairs if pair.level > limit for one in (pair.first, pair.second)))
    return DataFinding(
        "not_repeatable", "warning", axis.joint, ids, value, limit,
        f"{axis.joint}: mean effort of repeats differs by {value:.3g} {axis.unit} (median of {len(pairs)} pairs, "
        f"limit {limit:.3g}, {named(ids)}).",
        "Look for what drags the second time, a drive whose offset wanders, and whether the repeats are of one pose.",
    )  # fmt: skip


def _anywhere(pairs: Sequence[Pair], those: Mask) -> bool:
    """Whether these pairs occur in all kinds of motion, by Fisher's exact test of the kind with the most of them."""
    alike: dict[object, list[bool]] = {}
    for pair, yes in zip(pairs, those, strict=True):
        alike.setdefault((pair.first.spec.offset_velocity, pair.first.spec.sines), []).append(bool(yes))
    chances = [hypergeometric_tail(sum(one), len(pairs), int(those.sum()), len(one)) for one in alike.values()]
    # below 0.05, one kind of motion has more of these pairs than the others
    return 2 * sum(map(any, alike.values())) >= len(alike) and min(chances) > 0.05


def _still(pair: Pair) -> bool:
    return pair.first.spec.excitation == "standstill"


def _pairs(axis: AxisRecords) -> list[Pair]:
    """Consecutive repeats, measured back to back."""
    groups: dict[object, list[Record]] = {}
    for record in axis.those(lambda record: record.alone and record.spec.excitation != "noise"):
        spec = record.spec
        key = (spec.pose, spec.block, spec.excitation, spec.offset_velocity, spec.sines, record.count, record.rate)
        groups.setdefault(key, []).append(record)
    found: list[Pair] = []
    for group in groups.values():
        ordered = sorted(group, key=lambda record: record.spec.started_at)
        for first, second in pairwise(ordered):
            length = len(second.sweep.recording.time) / second.rate
            # 120.0 s: longest time from one repeat to the next
            if second.spec.started_at - first.spec.started_at <= 120.0 + length:
                pair = _pair(first, second)
                if pair is not None:
                    found.append(pair)
    return found


def _pair(first: Record, second: Record) -> Pair | None:
    """None if the windows are too short for the bands."""
    count, rate = first.count, first.rate
    difference = (second.effort - first.effort) / np.sqrt(2)
    level = float(np.sqrt(2) * abs(difference.mean()))
    number = np.arange(count)
    trend = np.polynomial.Polynomial.fit(number, difference, 1)
    difference = difference - trend(number)
    power, frequency = _power(difference, rate)
    low = (frequency >= BAND[0]) & (frequency <= BAND[1])
    high = (frequency >= OWN[0]) & (frequency <= min(OWN[1], 0.4 * rate))
    if np.count_nonzero(low) < 8 or np.count_nonzero(high) < 8:
        return None
    return Pair(first, second, level, difference, float(np.sqrt(power[low].mean())), float(np.sqrt(power[high].mean())))


def _power(difference: Array, rate: float) -> tuple[Array, Array]:
    """Power per bin (their sum is the mean square), and the frequencies of the bins."""
    count = len(difference)
    window = np.hanning(count)
    transform: Complex = np.fft.rfft(difference * window)
    frequency = np.asarray(np.arange(len(transform)) * (rate / count), dtype=np.float64)
    power = 2 * (transform * transform.conj()).real / (count * float(window @ window))
    return power, frequency


def _how(pairs: Sequence[Pair]) -> str:
    """Description: at a frequency, in bursts, or broadband."""
    sizes = {len(pair.difference) for pair in pairs}
    count = max(sizes, key=lambda size: sum(len(pair.difference) == size for pair in pairs))
    some = [pair for pair in pairs if len(pair.difference) == count]
    rate = some[0].first.rate
    power = np.mean([_power(pair.difference, rate)[0] for pair in some], axis=0)
    frequency = np.arange(len(power)) * (rate / count)
    low = (frequency >= BAND[0]) & (frequency <= BAND[1])
    peak = int(np.argmax(np.where(low, power, 0.0)))
    near = slice(max(peak - 2, 0), peak + 3)
    # 0.3 of the power of the difference within two bins of its peak: then the finding gives a frequency
    if float(power[near].sum()) > 2 * 0.3 * float(power[low].sum()):
        middle = float(power[near] @ frequency[near]) / float(power[near].sum())
        return f"at {middle:.2g} Hz"
    part = max(round(0.1 * rate), 1)
    chunks = [pair.difference[: count - count % part].reshape(-1, part).std(axis=1) for pair in some]
    bursts = float(np.median([chunk.max() / max(float(np.median(chunk)), 1e-12) for chunk in chunks])) > 4
    return "in bursts, as stick events make them" if bursts else "at no single frequency"
