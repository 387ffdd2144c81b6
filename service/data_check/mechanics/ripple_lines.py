r"""Lines in the motor's angle: what effort does beside its periods, in which order does it repeat?

What effort does beside its periods (sines, friction and inertia repeat with them) is taken as a function of the motor's
angle theta = gear ratio x position. A ripple of order o is a line there, in each sweep

    a(o) = 2 / N  sum  left(t) exp(-i o theta(t))

and it has one phase in all poses, because theta is absolute: settling and friction have not. Of the c places where the
axis was swept alike (one offset and one set of sines) the coherent part of the power

    rho = |sum a|^2 / (c sum |a|^2),    chance of that or more with random phases: (1 - rho)^(c - 1)

(a of a complex normal distribution: rho is of the beta distribution B(1, c - 1)). Fisher's sum of -2 ln chance over the
sets of sweeps alike is chi-squared of twice as many degrees of freedom. Over the range of the axis the phases tell o to
some 1e-4, fine enough to see a wrong gear ratio.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from service.data_check.record import AxisRecords, Record
from service.identification.spectra.frequency_response import Complex, ripple_orders
from service.recording import Array

RATE = 400.0  # Hz at least that are kept of effort: a ripple of 200 Hz moves no axis
HIGHEST = 100.0  # order
SLOWEST = 3.0  # periods in the slowest sweep: fewer are no line
CHANCE = 1e-6  # that phases of something else lie like this, at any order that was tried
PLACES = 3  # that must be swept alike
ABOVE = 8.0  # times the median of the power over the orders: a line
SAME = 0.01  # part by which an order of the robot file may be off and still be meant
MOST = 3  # lines that are looked at
HIDDEN = 0.1  # of a ripple that is nearly one with the periods
FINE = 0.1  # of the order that all sweeps together resolve


@dataclass(frozen=True)
class Line:
    """A ripple: `order` in periods a motor turn by the robot file's gear ratio, RMS in N m (N).

    `chance`: natural logarithm of that its phases are one by chance; the same `as_known` at the order of the robot file
    that is nearest, `known`, if one is near. `resolved`: the order that the range of the axis tells apart.
    """

    order: float
    rms: float
    chance: float
    known: float | None
    as_known: float
    resolved: float


@dataclass(frozen=True)
class Turning:
    """A record in the motor's angle: `angle` (n,) rad, `left` (n,) N m (N); samples a period."""

    record: Record
    angle: Array
    left: Array
    period: int

    @property
    def alike(self) -> object:
        """What all records that are measured alike have in common."""
        return self.record.spec.offset_velocity, self.record.spec.sines

    @property
    def span(self) -> float:
        return float(np.ptp(self.angle))

    @property
    def middle(self) -> float:
        return float(self.angle.mean())


def _turning(axis: AxisRecords, record: Record) -> Turning | None:
    """None where the axis turns round or the window is not of two periods and more."""
    spec = record.spec
    if not (record.turns and record.alone and spec.periodic and spec.period and spec.periods and spec.periods > 1):
        return None
    few = max(int(record.rate / RATE), 1)
    period = round(spec.period * record.rate / few)
    count = period * spec.periods
    if count * few > record.count or not (np.all(record.velocity > 0) or np.all(record.velocity < 0)):
        return None
    effort, position = (
        values[: count * few].reshape(-1, few).mean(axis=1) for values in (record.effort, record.position)
    )
    return Turning(record, axis.axis.gear_ratio * position, _beside_periods(effort, period), period)


def _beside_periods(values: Array, period: int) -> Array:
    """(n, ...) without a parabola and without what repeats with the period."""
    count = len(values)
    powers = np.polynomial.legendre.legvander(np.linspace(-1, 1, count), 2)
    shaped = values.reshape(count, -1)
    for _ in range(2):  # what the one leaves of the other is small
        shaped = shaped - powers @ np.linalg.lstsq(powers, shaped, rcond=None)[0]
        turns = shaped.reshape(count // period, period, -1)
        shaped = (turns - turns.mean(axis=0)).reshape(count, -1)
    return shaped.reshape(values.shape)


def _places(turning: Sequence[Turning], one: Turning) -> int:
    """Where else the axis was swept like that."""
    return len({_place(other) for other in turning if other.alike == one.alike})


def _place(one: Turning) -> float:
    return round(float(one.record.position[0]), 2)


def ripple_lines(axis: AxisRecords) -> list[Line]:
    """The strongest first; of records that turn one way, alike in `PLACES` places at least."""
    every = [one for record in axis.records if (one := _turning(axis, record)) is not None]
    turning = [one for one in every if _places(every, one) >= PLACES]
    found: list[Line] = []
    for _ in range(MOST if turning else 0):
        spectra = _Spectra.of(turning)
        line = spectra.strongest(axis)
        if line is None:
            break
        if line.chance < np.log(CHANCE / max(spectra.tried, 1.0)):
            found.append(line)
        turning = [_without(one, line.order) for one in turning]
    return found


def _without(one: Turning, order: float) -> Turning:
    """With the line taken out of the record."""
    waves = np.stack([np.cos(order * one.angle), np.sin(order * one.angle)], -1)
    columns = _beside_periods(waves, one.period)
    return replace(one, left=one.left - columns @ np.linalg.lstsq(columns, one.left, rcond=None)[0])


@dataclass(frozen=True)
class _Spectra:
    """`amplitude` (m, o) of each record at `order` (o,), NaN where its speed shows none.

    `groups` of records alike, each of places, each of the records there.
    """

    turning: Sequence[Turning]
    order: Array
    amplitude: Complex
    groups: tuple[tuple[tuple[int, ...], ...], ...]

    @classmethod
    def of(cls, turning: Sequence[Turning]) -> "_Spectra":
        step = 0.8 * np.pi / HIGHEST
        size = 1 << int(np.ceil(np.log2(4 * max(one.span for one in turning) / step)))
        every = np.arange(size // 2 + 1, dtype=np.float64) * (2 * np.pi / (size * step))
        order = every[every <= HIGHEST]
        amplitude = np.empty((len(turning), len(order)), dtype=np.complex128)
        lowest_order = SLOWEST * 2 * np.pi / min(one.span for one in turning)
        for k, one in enumerate(turning):
            way = 1.0 if one.angle[-1] > one.angle[0] else -1.0
            lowest = float(one.angle.min())
            even = lowest + step * np.arange(int(one.span / step) + 1)
            left = np.interp(even, one.angle[:: int(way)], one.left[:: int(way)])
            line = 2 * np.fft.rfft(left, size)[: len(order)] / len(even)
            amplitude[k] = line * np.exp(-1j * order * lowest)
            seconds = len(one.angle) / (one.record.rate / max(int(one.record.rate / RATE), 1))
            fastest = 0.4 * len(one.angle) / seconds / (one.span / seconds / (2 * np.pi))
            amplitude[k, (order > fastest) | (order < lowest_order)] = np.nan
        names = list(dict.fromkeys(one.alike for one in turning))
        groups = tuple(
            tuple(
                tuple(k for k, one in enumerate(turning) if one.alike == name and _place(one) == place)
                for place in sorted({_place(one) for one in turning if one.alike == name})
            )
            for name in names
        )
        return cls(turning, order, amplitude, groups)

    @property
    def tried(self) -> float:
        """Orders that all records together tell apart."""
        middle = [one.middle for one in self.turning]
        return HIGHEST * float(np.ptp(middle)) / (2 * np.pi)

    def strongest(self, axis: AxisRecords) -> Line | None:
        power = np.zeros(len(self.order))
        seen = np.zeros(len(self.order))
        for group in self.groups:
            own = np.mean([np.abs(self.amplitude[list(place)].mean(axis=0)) ** 2 for place in group], axis=0)
            there = np.isfinite(own)
            if there.any():
                power[there] += own[there] / float(np.median(own[there]))
                seen[there] += 1
        level = np.divide(power, seen, out=np.zeros_like(power), where=seen > 0)
        best = int(np.argmax(level))
        if level[best] < ABOVE:
            return None
        grid, order, rms = self.refined(best)
        known = min(ripple_orders(axis.axis), key=lambda one: abs(one / order - 1), default=None)
        near = known if known is not None and abs(order / known - 1) < SAME else None
        as_known = self.chance(int(np.argmin(np.abs(self.order - near))), near) if near is not None else 0.0
        return Line(order, rms, self.chance(grid, order), near, as_known, HIGHEST / max(self.tried, 1e-9))

    def chance(self, grid: int, order: float) -> float:
        """Logarithm, at an order near one of the grid."""
        turn = np.exp(-1j * (order - self.order[grid]) * np.array([one.middle for one in self.turning]))
        amplitude = self.amplitude[:, grid] * turn
        total, sets = 0.0, 0
        for group in self.groups:
            values = np.array([amplitude[list(place)].mean() for place in group])
            if len(values) >= PLACES and np.isfinite(values).all():
                share = abs(values.sum()) ** 2 / (len(values) * float(np.sum(np.abs(values) ** 2)))
                total -= 2 * (len(values) - 1) * float(np.log(max(1 - share, 1e-12)))
                sets += 1
        return float(chi2.logsf(total, 2 * sets)) if sets else 0.0

    def refined(self, grid: int) -> tuple[int, float, float]:
        """Where in the grid, which order near it both explains most and has phases least by chance, and its RMS."""
        middle = np.array([one.middle for one in self.turning])
        everywhere = float(np.ptp(middle)) + 1e-9
        reach = 2 * np.pi / min(one.span for one in self.turning)
        near = np.flatnonzero(np.abs(self.order - self.order[grid]) <= reach)
        step = float(self.order[1] - self.order[0])
        count = min(int(step * everywhere / (FINE * 2 * np.pi)) + 1, 400)
        off = step * ((np.arange(count) + 0.5) / count - 0.5)
        turn = np.exp(-1j * off[:, None] * middle)  # (f, m)
        gained, size, agree = np.zeros((3, len(near), count))
        for group in self.groups:
            members = [k for place in group for k in place]
            rest = float(np.mean([np.mean(self.turning[k].left ** 2) for k in members]))
            one = self.turning[members[0]]
            wave = _beside_periods(np.exp(1j * np.outer(one.angle, self.order[near])), one.period)
            kept = np.maximum(np.mean(np.abs(wave) ** 2, axis=0), HIDDEN)[:, None]
            places = np.array([turn[:, p] @ self.amplitude[list(p)][:, near] / len(p) for p in map(list, group)])
            places = np.nan_to_num(np.swapaxes(places, 1, 2))  # (p, n, f)
            mean, power = np.abs(places.mean(axis=0)) ** 2, np.mean(np.abs(places) ** 2, axis=0)
            explained = np.minimum(mean / (2 * kept), 0.999 * rest)
            size = np.maximum(size, explained / kept)
            gained -= len(members) * len(one.left) * np.log(1 - explained / rest) / 2
            agree -= (len(group) - 1) * np.log(np.maximum(1 - mean / np.maximum(power, 1e-30), 1e-12))
        likely = gained / max(float(gained.max()), 1e-30) + agree / max(float(agree.max()), 1e-30)
        best, fine = np.unravel_index(int(np.argmax(likely)), likely.shape)
        return int(near[best]), float(self.order[near[best]] + off[fine]), float(np.sqrt(size[best, fine]))
