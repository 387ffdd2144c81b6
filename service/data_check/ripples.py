"""Torque ripple in the motor angle: are its orders those of the robot file, with its gear ratio?

The part of effort that does not repeat with the period (sines, friction and inertia do) is a function of the
motor angle theta = gear ratio x position. A ripple of order o is a line in it, for each sweep

    a(o) = 2 / N  sum  left(t) exp(-i o theta(t))

with the same phase in all poses, because theta is absolute. Settling and friction have none. For the c places
where the axis was swept in the same way (one offset, one set of sines), the coherent part of the power is

        rho = |sum a|^2 / (c sum |a|^2),    probability of at least rho with random phases: (1 - rho)^(c - 1)

(for complex normal a, rho has the beta distribution B(1, c - 1)). Fisher's sum of -2 ln probability over the sets of
equal sweeps is chi-squared with twice as many degrees of freedom. Over the range of the axis, the phases give o to
about 1e-4, which is accurate enough to detect a wrong gear ratio.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.data_check.finding import DataFinding
from service.data_check.probabilities import log_chi2_above
from service.data_check.record import AxisRecords, Record
from service.identification.spectra.frequency_response import Complex, ripple_orders
from service.model import Array

RATE = 400.0  # Hz, minimum rate of effort after decimation: a ripple of 200 Hz moves no axis
HIGHEST = 100.0  # order
CHANCE = 1e-6  # probability of such phases without ripple, over all tried orders
PLACES = 3  # minimum number of places with the same sweep
ABOVE = 8.0  # times the median power over the orders: a line
SAME = 0.01  # relative difference up to which an order of the robot file is the same order


@dataclass(frozen=True)
class Line:
    """A ripple: `order` in periods per motor turn with the gear ratio of the robot file, RMS in N m (N).

    `chance`: natural logarithm of the probability of such phases by chance. `as_known`: the same at the nearest order
    of the robot file, `known`, if one is near. `resolved`: order resolution over the range of the axis.
    """

    order: float
    rms: float
    chance: float
    known: float | None
    as_known: float
    resolved: float


@dataclass(frozen=True)
class Turning:
    """A record as a function of the motor angle: `angle` (n,) rad, `left` (n,) N m (N); samples per period."""

    record: Record
    angle: Array
    left: Array
    period: int

    @property
    def alike(self) -> object:
        """Key that is equal for all records with the same motion."""
        return self.record.spec.offset_velocity, self.record.spec.sines

    @property
    def span(self) -> float:
        return float(np.ptp(self.angle))

    @property
    def middle(self) -> float:
        return float(self.angle.mean())


def _turning(axis: AxisRecords, record: Record) -> Turning | None:
    """None if the axis reverses or the window is shorter than two periods."""
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
    """(n, ...) minus a parabola and minus the part that repeats with the period."""
    count = len(values)
    powers = np.polynomial.legendre.legvander(np.linspace(-1, 1, count), 2)
    shaped = values.reshape(count, -1)
    for _ in range(2):  # each subtraction leaves a small part of the other
        shaped = shaped - powers @ np.linalg.lstsq(powers, shaped, rcond=None)[0]
        turns = shaped.reshape(count // period, period, -1)
        shaped = (turns - turns.mean(axis=0)).reshape(count, -1)
    return shaped.reshape(values.shape)


def _places(turning: Sequence[Turning], one: Turning) -> int:
    """Number of places where the axis had the same sweep."""
    return len({_place(other) for other in turning if other.alike == one.alike})


def _place(one: Turning) -> float:
    return round(float(one.record.position[0]), 2)


def ripple_lines(axis: AxisRecords) -> list[Line]:
    """The lines, strongest first; from records in one direction, with the same sweep in at least `PLACES` places."""
    every = [one for record in axis.records if (one := _turning(axis, record)) is not None]
    turning = [one for one in every if _places(every, one) >= PLACES]
    found: list[Line] = []
    # 3 largest number of lines
    for _ in range(3 if turning else 0):
        spectra = _Spectra.of(turning)
        line = spectra.strongest(axis)
        if line is None:
            break
        if line.chance < np.log(CHANCE / max(spectra.tried, 1.0)):
            found.append(line)
        turning = [_without(one, line.order) for one in turning]
    return found


def _without(one: Turning, order: float) -> Turning:
    """The record without this line."""
    waves = np.stack([np.cos(order * one.angle), np.sin(order * one.angle)], -1)
    columns = _beside_periods(waves, one.period)
    return replace(one, left=one.left - columns @ np.linalg.lstsq(columns, one.left, rcond=None)[0])


@dataclass(frozen=True)
class _Spectra:
    """`amplitude` (m, o) of each record at `order` (o,), NaN if its speed is too low or high for the order.

    `groups`: sets of equal records; each contains places, each of these the records there.
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
        # 3.0 periods in the slowest sweep: minimum for a line
        lowest_order = 3.0 * 2 * np.pi / min(one.span for one in turning)
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
        """Number of orders that all records together can separate."""
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
        """Logarithm of the probability, at an order near one of the grid."""
        turn = np.exp(-1j * (order - self.order[grid]) * np.array([one.middle for one in self.turning]))
        amplitude = self.amplitude[:, grid] * turn
        total, sets = 0.0, 0
        for group in self.groups:
            values = np.array([amplitude[list(place)].mean() for place in group])
            if len(values) >= PLACES and np.isfinite(values).all():
                share = abs(values.sum()) ** 2 / (len(values) * float(np.sum(np.abs(values) ** 2)))
                total -= 2 * (len(values) - 1) * float(np.log(max(1 - share, 1e-12)))
                sets += 1
        return log_chi2_above(total, sets)

    def refined(self, grid: int) -> tuple[int, float, float]:
        """Index in the grid, the nearby order with the largest power and the least probable phases, and its RMS."""
        middle = np.array([one.middle for one in self.turning])
        everywhere = float(np.ptp(middle)) + 1e-9
        reach = 2 * np.pi / min(one.span for one in self.turning)
        near = np.flatnonzero(np.abs(self.order - self.order[grid]) <= reach)
        step = float(self.order[1] - self.order[0])
        # 0.1 of the order resolution of all sweeps together
        count = min(int(step * everywhere / (0.1 * 2 * np.pi)) + 1, 400)
        off = step * ((np.arange(count) + 0.5) / count - 0.5)
        turn = np.exp(-1j * off[:, None] * middle)  # (f, m)
        gained, size, agree = np.zeros((3, len(near), count))
        for group in self.groups:
            members = [k for place in group for k in place]
            rest = float(np.mean([np.mean(self.turning[k].left ** 2) for k in members]))
            one = self.turning[members[0]]
            wave = _beside_periods(np.exp(1j * np.outer(one.angle, self.order[near])), one.period)
            # 0.1 of a ripple that nearly coincides with the periods
            kept = np.maximum(np.mean(np.abs(wave) ** 2, axis=0), 0.1)[:, None]
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


SIDE = (1.0, 2.0)  # an eccentric rotor gives weaker lines at this distance from a line of order o


def ripples(axis: AxisRecords) -> list[DataFinding]:
    """Findings: a gear ratio with which the known orders are too high or too low, and unknown orders."""
    lines = ripple_lines(axis)
    return [*_ratio(axis, lines), *_unknown(axis, lines)]


def _ratio(axis: AxisRecords, lines: Sequence[Line]) -> list[DataFinding]:
    """From the strongest line of a known order, if its phases do not agree with that order."""
    scale = _scale(lines)
    if scale is None:
        return []
    line, given = next(line for line in lines if line.known is not None), axis.axis.gear_ratio
    return [
        DataFinding(
            "gear_ratio", "warning", axis.joint, (), given * scale, given,
            f"{axis.joint}: the ripple of order {line.known:g} ({line.rms:.3g} {axis.unit}) repeats {scale:.5f} times "
            f"as often as the robot file's gear ratio {given:g} says; {given * scale:.6g} fits in all poses.",
            "Check the gear ratio in the robot file and in the drive.",
        )
    ]  # fmt: skip


def _scale(lines: Sequence[Line]) -> float | None:
    """Factor by which the gear ratio is wrong; None if it is correct."""
    line = next((line for line in lines if line.known is not None), None)
    if line is None or line.known is None:
        return None
    scale, off = line.order / line.known, abs(line.order - line.known)
    # 0.25 of the order resolution over the range of the axis
    clear = off > 0.25 * line.resolved and line.as_known - line.chance > -np.log(CHANCE)
    # 5e-4 of the gear ratio: a larger difference is reported
    return scale if abs(scale - 1) > 5e-4 and clear else None


def _unknown(axis: AxisRecords, lines: Sequence[Line]) -> list[DataFinding]:
    """Lines that are neither in the robot file nor side lines of a stronger one."""
    whole = 0.02  # tolerance: orders of a motor are whole numbers (magnets, teeth)
    scale, findings = _scale(lines) or 1.0, list[DataFinding]()
    known = list(ripple_orders(axis.axis))
    for line in lines:
        order = line.order / scale
        near = [one for one in known if abs(order / one - 1) < SAME]
        beside = [one for one in known for side in SIDE if abs(abs(order - one) - side) < whole * max(1.0, one / 20)]
        # 0.001 of rated effort, RMS: one step of typical drives
        # 0.25 of the strongest line: a weaker one may be caused by the drive from that one
        if near or beside or line.rms < max(0.001 * axis.axis.rated_effort, 0.25 * lines[0].rms):
            continue
        if abs(order - round(order)) > whole * max(1.0, order / 20):
            continue
        order = float(round(order))
        known.append(order)
        # 5.0 order: below, transmission error of the gear; above, cogging of the motor
        kind = "transmission" if order < 5.0 else "cogging"
        findings.append(
            DataFinding(
                "ripple_order", "warning", axis.joint, (), order, None,
                f"{axis.joint}: effort ripples {order:.6g} times a motor turn ({line.rms:.3g} {axis.unit} RMS, one "
                "phase in all poses), which the robot file does not know.",
                f"Add it to {kind}_orders of the robot file.",
            )
        )  # fmt: skip
    return findings
