r"""Search for torque ripples that are not in the robot file: orders of the motor angle with a periodic residual.

A ripple of order o is a spectral line in the motor angle theta at each speed. For each sweep

    a(o) = 2 / N  sum  left(t) exp(-i o theta(t)),     power(o) = mean over pairs of repeats  Re a_1 conj(a_2) / 2

so noise, which does not repeat, is removed. A peak of the power far above the median is an order. Because theta is
absolute, the phases of all sweeps together give the order to a fraction of one turn over the whole range of the axis,
which is accurate enough to detect a wrong gear ratio.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.data_check import DataFinding
from service.diagnosis.fit.equations import Equations
from service.diagnosis.rows.signals import BAND, row_samples
from service.model import Array, Axis, Complex, Mask, Robot

PEAK = 0.3  # of the residual power: a ripple above is reported


@dataclass(frozen=True, slots=True)
class RippleLine:
    """A line in the motor angle: periods per motor turn with the gear ratio of the robot file; RMS, N m (N)."""

    order: float
    rms: float


def ripples(given: Equations, left: Array) -> tuple[RippleLine, ...]:
    """The lines in the residual (n, rows) of a model, strongest first."""
    tracks = given.tracks
    ratio = abs(tracks.robot.axis(tracks.joint).gear_ratio)
    angle = ratio * tracks.position[:, row_samples(tracks.effort.shape[1], tracks.rate)]
    pairs = [(g.pieces[0].sweep, g.pieces[1].sweep) for g in given.groups if len(g.pieces) > 1]
    pairs = pairs or [(g.pieces[0].sweep, g.pieces[0].sweep) for g in given.groups]
    turning = [pair for pair in pairs if abs(tracks.specs[pair[0]].offset_velocity) > 0]
    if not turning:
        return ()
    travel = float(np.median([np.ptp(angle[k][tracks.usable[k]]) for k, _ in turning if tracks.usable[k].any()]))
    orders = _orders(given, turning, ratio, travel)
    if not len(orders):
        return ()
    rest, found = left.copy(), list[RippleLine]()
    whole = _power(rest, tracks.usable, turning)
    # 4 largest number of orders
    for _ in range(4):
        power = _spectrum(rest, angle, tracks.usable, turning, orders)
        best = int(np.argmax(power))
        # 8.0 times the median over the orders
        if power[best] < PEAK * whole / 2 or power[best] < 8.0 * float(np.median(np.abs(power))):
            break
        order = _refined(rest, angle, tracks.usable, turning, float(orders[best]), travel)
        found.append(RippleLine(order, float(np.sqrt(power[best]))))
        rest = _without(rest, angle, tracks.usable, order)
        whole = max(_power(rest, tracks.usable, turning), 1e-30)
    return tuple(found)


def with_ripples(robot: Robot, joint: str, found: Sequence[RippleLine]) -> tuple[Robot, tuple[DataFinding, ...]]:
    """The robot with the orders added or the gear ratio corrected, and the changes; the same robot if the file contains
    all of the ripples.
    """
    same = 0.02  # relative difference up to which an order of the robot file is the same order
    axis, said = robot.axis(joint), list[DataFinding]()
    known = (*axis.cogging_orders, *axis.transmission_orders)
    near = [
        (ripple.order / order, order) for ripple in found for order in known if abs(ripple.order / order - 1) < same
    ]
    ratio, orders = axis.gear_ratio, {"transmission": axis.transmission_orders, "cogging": axis.cogging_orders}
    scale = 1.0
    # 5e-4 of the gear ratio: a larger difference is reported
    if near and abs(near[0][0] - 1) > 5e-4:
        scale, order = near[0]
        ratio = axis.gear_ratio * scale
        said.append(
            DataFinding(
                "gear_ratio", "warning", joint, (), ratio, axis.gear_ratio,
                f"{joint}: the ripple of order {order:g} repeats {scale:.5f} times as often as the robot file's gear "
                f"ratio {axis.gear_ratio:g} says; {ratio:.6g} fits.",
                "Check the gear ratio in the robot file and in the drive.",
            )
        )  # fmt: skip
    for ripple in found:
        order = ripple.order / scale
        if any(abs(order / other - 1) < same for other in known):
            continue
        # 0.02 tolerance relative to an order of 20: orders are whole numbers
        order = float(round(order)) if abs(order - round(order)) < 0.02 * max(1.0, order / 20) else order
        # 5.0 order: below, transmission error of the gear; above, cogging of the motor
        kind = "transmission" if order < 5.0 else "cogging"
        orders[kind] = (*orders[kind], order)
        said.append(
            DataFinding(
                "ripple_order", "warning", joint, (), order, None,
                f"{joint}: the torque ripples {order:g} times a motor turn, which the robot file does not know.",
                f"Add it to {kind}_orders of the robot file.",
            )
        )  # fmt: skip
    if not said:
        return robot, ()
    change = {"gear_ratio": ratio, **{f"{kind}_orders": value for kind, value in orders.items()}}
    return _changed(robot, joint, axis.model_copy(update=change)), tuple(said)


def _changed(robot: Robot, joint: str, axis: Axis) -> Robot:
    axes = tuple(axis if one.joint == joint else one for one in robot.axes)
    return replace(robot, description=robot.description.model_copy(update={"axes": axes}))


def _orders(given: Equations, turning: Sequence[tuple[int, int]], ratio: float, travel: float) -> Array:
    """Orders in the band of the slowest sweeps, with the resolution of one sweep."""
    speed = min(abs(given.tracks.specs[k].offset_velocity) for k, _ in turning) * ratio / (2 * np.pi)
    # 0.25 of the order resolution of one sweep
    step = 0.25 * 2 * np.pi / travel
    # 100.0 order
    # Hz: slower signals are not ripple in a sweep of seconds
    lowest, highest = max(0.5 / speed, 4 * step), min(2 * BAND / speed, 100.0)
    return np.arange(lowest, highest, step) if highest > lowest else np.empty(0)


def _amplitudes(left: Array, angle: Array, usable: Mask, sweep: int, orders: Array) -> Complex:
    good = usable[sweep]
    wave = np.exp(-1j * np.outer(orders, angle[sweep][good]))
    return np.asarray(2 * (wave @ left[sweep][good]) / max(int(good.sum()), 1), dtype=np.complex128)


def _spectrum(left: Array, angle: Array, usable: Mask, turning: Sequence[tuple[int, int]], orders: Array) -> Array:
    total = np.zeros(len(orders))
    for one, other in turning:
        first = _amplitudes(left, angle, usable, one, orders)
        second = first if other == one else _amplitudes(left, angle, usable, other, orders)
        total += (first * second.conj()).real / 2
    return total / len(turning)


def _power(left: Array, usable: Mask, turning: Sequence[tuple[int, int]]) -> float:
    """Repeatable power, N^2 m^2."""
    powers: list[float] = []
    for one, other in turning:
        product: Array = np.multiply(left[one], left[other], dtype=np.float64)
        powers.append(float(np.mean(product[usable[one] & usable[other]])))
    return max(float(np.nanmean(powers)), 0.0)


def _refined(
    left: Array,
    angle: Array,
    usable: Mask,
    turning: Sequence[tuple[int, int]],
    order: float,
    travel: float,
) -> float:
    """The order for which one amplitude and phase fit all sweeps best."""
    sweeps = sorted({k for pair in turning for k in pair})
    reach = 2 * np.pi / travel
    everywhere = float(np.ptp(np.concatenate([angle[k][usable[k]] for k in sweeps])))
    # 0.05 of the order resolution of all sweeps together
    tried = np.arange(order - reach / 2, order + reach / 2, 0.05 * 2 * np.pi / everywhere)
    total = sum(_amplitudes(left, angle, usable, k, tried) for k in sweeps)
    return float(tried[int(np.argmax(np.abs(total)))])


def _without(left: Array, angle: Array, usable: Mask, order: float) -> Array:
    """The residual without this line in each sweep."""
    result = left.copy()
    for k in range(len(left)):
        good = usable[k]
        if good.any():
            columns = np.stack([np.sin(order * angle[k]), np.cos(order * angle[k])], axis=-1)
            result[k] -= columns @ np.linalg.lstsq(columns[good], left[k][good], rcond=None)[0]
    return result
