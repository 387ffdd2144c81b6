"""Where model and measurement differ: the gap as a function of each property of a sweep and of a sample.

The significance of a cell is the sum of the products of its residuals between repeats, over the standard deviation for
noise, so noise that does not repeat has no effect. Without repeats, the squares minus the noise power are used.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc, ndtri

from service.diagnosis.fit.cross_products import Group
from service.diagnosis.fit.equations import Equations
from service.diagnosis.rows.signals import EVERY, Tracks, row_samples
from service.model import Array, Indices, Mask
from service.model.results.diagnosis import Cell, Example

SIGNIFICANT = 5.0
MANY = 1.5  # times the total RMS: a cell above is reported
STEADY = 0.8  # rank correlation with a property: above, the gap increases with it
SURE = 1 - 1e-15  # the largest such probability
WAYS = ("direction", "weight")
ORDERED = ("speed", "|gravity torque|", "time since start", "temperature", "line frequency")


@dataclass(frozen=True)
class _Rows:
    """Usable rows, flat: products of residuals of two repeats, before and after, and the signals used for the bins."""

    product: Array
    after: Array
    number: Indices  # of the sweep
    row: Indices


def cells(tracks: Tracks, groups: Sequence[Group], residual: Array, after: Array, noise: float) -> tuple[Cell, ...]:
    """The gap of residuals (n, rows), N m (N), before and after, in bins of the properties of sweeps and samples."""
    rows = _rows(tracks, groups, residual, after, noise)
    if rows.product.size == 0:
        return ()
    found: list[Cell] = []
    for dimension, labels in _labels(tracks, rows):
        found.extend(_cell(dimension, str(value), rows, labels == value, noise) for value in np.unique(labels))
    return tuple(sorted(found, key=lambda cell: -cell.significance))


def lines(tracks: Tracks, residual: Array, after: Array) -> tuple[Cell, ...]:
    """The gap at the excited frequencies: RMS of the residual at each line over the sweeps that contain it, and its
    significance with respect to the bins between the lines, in standard deviations of equal probability.
    """
    smallest = 1e-300  # smallest power, and smallest probability for the inverse normal distribution
    every = EVERY / tracks.rate
    start = row_samples(tracks.effort.shape[1], tracks.rate)[0] / tracks.rate
    power: dict[float, list[Array]] = {}  # of a line, its neighbouring bins, and the line after
    for number, spec in enumerate(tracks.specs):
        if spec.period is None or spec.periods is None or spec.periods < 2 or not spec.sines:
            continue
        first, count = round((spec.measure_from - start) / every), round(spec.period * spec.periods / every)
        inside = (np.count_nonzero(tracks.inside[number]) - 1) / tracks.rate
        if first < 0 or first + count > residual.shape[1] or start + (first + count - 1) * every > inside:
            continue  # shorter than one window
        time = np.arange(count, dtype=np.float64) * every
        beside = (np.arange(1, spec.periods) / (spec.period * spec.periods)).tolist()
        window, later = residual[number, first : first + count], after[number, first : first + count]
        for sine in spec.sines:
            sides = [sine.frequency + side for offset in beside for side in (offset, -offset)]
            neighbours = float(np.mean([_power(window, time, side) for side in sides]))
            line, left = (_power(signal, time, sine.frequency) for signal in (window, later))
            power.setdefault(sine.frequency, []).append(np.array([line, neighbours, left, len(sides)]))
    result: list[Cell] = []
    for frequency, found in sorted(power.items()):
        means: list[float] = np.mean(found, axis=0).tolist()
        line, floor, left, sides = means
        freedom = 2 * len(found)  # sum of squares of normal values: two of each bin
        chance = float(fdtrc(freedom, freedom * sides, line / max(floor, smallest)))
        significance = float(-ndtri(min(max(chance, smallest), SURE)))
        result.append(
            Cell(
                dimension="line frequency",
                value=f"{frequency:g} Hz",
                rms=line**0.5,
                significance=significance,
                rms_after=left**0.5,
            )
        )
    return tuple(result)


def sentences(joint: str, found: Sequence[Cell]) -> tuple[str, ...]:
    """The gap in sentences for the user: when it occurs, with what it increases, and where it is largest."""
    significant = [cell for cell in found if cell.significance > SIGNIFICANT]
    if not significant:
        return (f"{joint}: no repeatable gap beyond the noise.",)
    by_dimension: dict[str, list[Cell]] = {}
    for cell in found:
        by_dimension.setdefault(cell.dimension, []).append(cell)
    pattern = {name: words for name, own in by_dimension.items() if (words := _only(name, own) or _trend(name, own))}
    result = [f"{joint}: {', '.join(pattern.values())}."] if pattern else []
    for dimension in dict.fromkeys(cell.dimension for cell in significant):
        own = by_dimension[dimension]
        typical = float(np.sqrt(np.mean([cell.rms**2 for cell in own])))
        high = [cell for cell in own if cell.rms > MANY * typical and cell.significance > SIGNIFICANT]
        if high and dimension not in pattern:
            where = " and ".join(cell.value for cell in sorted(high, key=lambda cell: -cell.rms)[:3])
            result.append(
                f"{joint}: the gap is largest at {dimension} {where} ({high[0].rms:.3g} against {typical:.3g})."
            )
    return tuple(result) or (f"{joint}: the gap is about the same everywhere.",)


def _only(dimension: str, own: Sequence[Cell]) -> str:
    """The one of two directions that contains the gap, if the other hardly contains it."""
    ways = sorted(own, key=lambda cell: cell.rms)
    if dimension not in WAYS or len(ways) != 2 or ways[1].significance < SIGNIFICANT:
        return ""
    # 0.3 of the gap in one direction: below, the other direction has no relevant gap
    return f"only when moving {ways[1].value}" if ways[0].rms < 0.3 * ways[1].rms else ""


def _trend(dimension: str, own: Sequence[Cell]) -> str:
    """Whether the gap increases or decreases monotonically with a property."""
    cells = sorted(own, key=lambda cell: float(cell.value.split()[0])) if dimension in ORDERED else []
    if len(cells) < 3 or max(cell.significance for cell in cells) < SIGNIFICANT:
        return ""
    gaps = np.array([cell.rms for cell in cells])
    ranks = np.argsort(np.argsort(gaps))
    steady = float(np.corrcoef(ranks, np.arange(len(ranks)))[0, 1])
    first, last = np.maximum(gaps[[0, -1]], 1e-300)
    if steady > STEADY and last > MANY * first:
        return f"grows with {dimension}"
    return f"falls with {dimension}" if steady < -STEADY and first > MANY * last else ""


def _power(signal: Array, time: Array, frequency: float) -> float:
    """Mean square of the component of a signal at one frequency."""
    return float(2 * np.abs(np.mean(signal * np.exp(-2j * np.pi * frequency * time))) ** 2)


def _cell(dimension: str, value: str, rows: _Rows, here: Mask, noise: float) -> Cell:
    mean, after = float(rows.product[here].mean()), float(rows.after[here].mean())
    # the filter correlates neighbouring rows: about four are one independent value
    significance = mean / max(noise**2, 1e-300) * np.sqrt(np.count_nonzero(here) / 4)
    return Cell(
        dimension=dimension,
        value=value,
        rms=float(np.sqrt(max(mean, 0.0))),
        significance=float(significance),
        rms_after=float(np.sqrt(max(after, 0.0))),
    )


def _rows(tracks: Tracks, groups: Sequence[Group], residual: Array, after: Array, noise: float) -> _Rows:
    products: list[Array] = []
    remaining: list[Array] = []
    numbers: list[Indices] = []
    at: list[Indices] = []
    for group in groups:
        good = np.stack([tracks.usable[p.sweep, p.first : p.first + p.rows] for p in group.pieces]).all(axis=0)
        where = np.flatnonzero(good)
        products.append(_repeated(group, residual, noise)[where])
        remaining.append(_repeated(group, after, noise)[where])
        numbers.append(np.full(len(where), group.pieces[0].sweep))
        at.append(where + group.pieces[0].first)
    return _Rows(np.concatenate(products), np.concatenate(remaining), np.concatenate(numbers), np.concatenate(at))


def _repeated(group: Group, residual: Array, noise: float) -> Array:
    """Mean product (rows,) of the residuals of different repeats."""
    parts = np.stack([residual[p.sweep, p.first : p.first + p.rows] for p in group.pieces])
    count, square = len(parts), np.sum(parts**2, axis=0)
    return (np.sum(parts, axis=0) ** 2 - square) / (count * (count - 1)) if count > 1 else square - noise**2


def _labels(tracks: Tracks, rows: _Rows) -> Iterator[tuple[str, NDArray[np.str_]]]:
    """For each property the name of the bin of each row."""
    index = tracks.robot.index(tracks.joint)
    samples = row_samples(tracks.effort.shape[1], tracks.rate)[rows.row]

    def at(signal: Array) -> Array:
        return signal[rows.number, samples]

    yield (
        "pose",
        np.array([f"{position:+.2f} rad" for position in tracks.poses[:, index]])[tracks.pose_index[rows.number]],
    )
    yield "block", np.array([spec.block or "sweep" for spec in tracks.specs])[rows.number]
    speed = at(tracks.velocity)
    yield "direction", np.where(speed >= 0, "forward", "backward")
    yield "speed", _binned(np.abs(speed), "rad/s")
    yield "acceleration", _binned(at(tracks.acceleration), "rad/s2")
    if np.ptp(tracks.gravity) > 0:
        pull = at(tracks.gravity)
        yield "gravity torque", _binned(pull, "N m")
        yield "|gravity torque|", _binned(np.abs(pull), "N m")
        yield "weight", np.where(speed * pull >= 0, "upwards", "downwards")
    yield "position within the sweep", _binned(at(tracks.position) - tracks.position[rows.number, 0], "rad")
    turns = at(tracks.position) * tracks.robot.axis(tracks.joint).gear_ratio / (2 * np.pi)
    yield "motor angle", np.array([f"{k}/8 turn" for k in range(8)])[(np.floor(8 * turns).astype(int)) % 8]
    yield "time since start", _binned(at(tracks.clock), "s")
    if tracks.temperature is not None:
        yield "temperature", _binned(at(tracks.temperature), "deg C")


def _binned(values: Array, unit: str) -> NDArray[np.str_]:
    bins = 6
    low, high = float(values.min()), float(values.max())
    edges = [low + (high - low) * k / bins for k in range(bins + 1)]
    number = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, bins - 1)
    return np.array([f"{low:.3g} to {high:.3g} {unit}" for low, high in pairwise(edges)])[number]


def example(given: Equations, before: Array, after: Array) -> Example:
    """The sweep with the largest residual (n, rows) before; all torques with the same filter."""
    tracks = given.tracks
    most = int(np.argmax(np.sum(np.where(tracks.usable, before, 0.0) ** 2, axis=1)))
    recorded = row_samples(tracks.effort.shape[1], tracks.rate)
    recorded = np.flatnonzero(tracks.inside[most][recorded])
    # 500 points
    at = recorded[:: -(-len(recorded) // 500)]
    measured = tracks.rows(tracks.effort[most : most + 1])[0, at]
    time = tracks.time[most, row_samples(tracks.effort.shape[1], tracks.rate)[at]]
    spec = tracks.specs[most]
    return Example(
        sweep=spec.id,
        block=spec.block,
        time=time.tolist(),
        measured=measured.tolist(),
        before=(measured - before[most, at]).tolist(),
        after=(measured - after[most, at]).tolist(),
    )
