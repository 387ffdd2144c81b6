"""Effort compared with motion: its sign, its unit, its delay, and whether it belongs to this axis.

Two signs are checked at the lowest line: inertia torque is in phase with acceleration, friction torque in phase with
velocity. If both are reversed, the sign of effort is wrong. The size is compared with CAD: all moving links and the
motor. Model errors within the prior, a payload, and a spring of 5 Hz stay within `OFF`.

Which axis has this effort? Compares inertia, weight and friction in all poses with this axis in each unit and with
the other axes. For another axis, the recorded pose is used as it is, or with the entries of both axes exchanged.
Of another axis either the pose is told as it stood, or its entry and this axis' have changed places with the columns.
Errors of CAD and of friction are some tens of per cent. A wrong unit or axis gives more, or does not fit all poses.

A delay D rotates the impedance of each line by an angle proportional to frequency, Z = (i w J + mu) exp(-i w D). Delays
up to about 2 ms come from physics and filters, which the diagnosis separates. Here D is only reported if it is
large, explains the lines, and neither a spring does,  Z = i w J / (1 - (w/w0)^2 + i w c) + mu,  nor a nonlinear gear: a
delay is linear and adds nothing at harmonics of the period that were not excited (Pintelon and Schoukens, System
Identification, 2012, 4.3), whereas play, which turns the lines like a delay, does.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from service import BadInput
from service.data_check.finding import DataFinding, named
from service.data_check.motion import Commanded, effort_unit, effort_units
from service.data_check.record import AxisRecords, Record
from service.identification.model import gravity_rows
from service.identification.spectra.frequency_response import Complex, ripple_orders, spectrum
from service.identification.spectra.time_domain import fit_record
from service.model import Array


@dataclass(frozen=True)
class Response:
    """Result of one record: apparent inertia, resistance (apparent viscous friction), errors; SI units, joint side.

    `frequency`, `impedance`, `error` (l,) at its lines, empty without lines; `distortion` as `error`: of the harmonics
    of the period between the lines, 0 if they are noise.
    """

    record: Record
    inertia: float
    inertia_error: float
    resistance: float
    resistance_error: float
    frequency: Array
    impedance: Complex
    error: Array
    distortion: Array


def responses(axis: AxisRecords, followed: dict[str, Commanded]) -> tuple[Response, ...]:
    """The responses of all records that determine inertia; velocity is converted to the commanded unit and sign."""
    found: list[Response] = []
    for record in axis.those(lambda record: record.alone and record.spec.shows_inertia):
        one = _at_lines(axis, record, followed.get(record.id)) if record.spec.periodic else _free(axis, record)
        if one is not None:
            found.append(one)
    return tuple(found)


def _at_lines(axis: AxisRecords, record: Record, followed: Commanded | None) -> Response | None:
    spec, count = record.spec, record.count
    step = record.rate / count
    frequency = np.sort([sine.frequency for sine in spec.sines])
    lines = np.round(frequency / step).astype(int)
    # Hz: below it, with locked-rotor frequencies of 5 Hz and more, a line shows the inertia, not the spring
    if frequency[0] > 4.5 or np.any(np.abs(frequency / step - lines) > 0.01) or lines[-1] >= count // 2:
        return None
    transform: Complex = np.fft.rfft(_without_ripple(axis, record, frequency)) / count
    velocity = np.fft.rfft(record.velocity)[lines] / count
    if followed is not None and followed.gain:
        velocity = velocity / followed.gain
    if not np.all(np.abs(velocity) > 0):
        return None
    # Hz above the last line: upper end of the noise band
    bins = np.arange(1, min(int(lines[-1]) + round(3.0 / step), count // 2))
    between = bins[~np.isin(bins, lines)]
    power = np.abs(transform[between]) ** 2
    noise = float(np.sqrt(np.mean(power))) if between.size else 0.0
    impedance, error = transform[lines] / velocity, noise / np.abs(velocity)
    repeated = between % (spec.periods or 1) == 0
    distortion = 0.0
    # 4.0 times the power of noise: more is no chance, even in four lines
    if repeated.any() and not repeated.all() and np.mean(power[repeated]) > 4.0 * np.mean(power[~repeated]):
        distortion = float(np.sqrt(np.mean(power[repeated])))
    omega = 2 * np.pi * frequency
    return Response(
        record,
        float(impedance[0].imag / omega[0]),
        float(error[0] / omega[0]),
        float(impedance[0].real),
        float(error[0]),
        frequency,
        impedance,
        error,
        distortion / np.abs(velocity),
    )


def _without_ripple(axis: AxisRecords, record: Record, frequency: Array) -> Array:
    """Effort (n,) without trend and without the ripple of known orders, as far as these differ from the lines."""
    count = record.count
    ramp = np.linspace(-0.5, 0.5, count)
    angles = [2 * np.pi * line * np.arange(count) / record.rate for line in frequency]
    turned = axis.axis.gear_ratio * (record.position - record.position[0])
    ripples = [order * turned for order in ripple_orders(axis.axis)]
    lines = np.array([wave(angle) for angle in angles for wave in (np.cos, np.sin)])
    others = np.array([np.ones(count), ramp, *(wave(angle) for angle in ripples for wave in (np.cos, np.sin))])
    columns = np.concatenate([others, lines]).T
    solution = np.asarray(np.linalg.lstsq(columns, record.effort, rcond=1e-6)[0], dtype=float)
    return record.effort - solution[: len(others)] @ others


def _free(axis: AxisRecords, record: Record) -> Response | None:
    try:
        fit = fit_record(spectrum(axis.robot, record.sweep))
    except BadInput:  # too short, or the motion does not determine inertia
        return None
    empty = np.zeros(0)
    resistance, error = fit.terms["viscous_friction"]
    return Response(record, fit.inertia, fit.inertia_std, resistance, error, empty, empty.astype(complex), empty, empty)


FITS = float(chdtri(3, 0.01))  # of three numbers
BETTER = 9.2  # difference of -2 ln likelihood: a hundred times as likely
REFUSED = 25.0  # the same for SI units of this axis: five standard deviations, because loads and springs are not errors


@dataclass(frozen=True)
class Origin:
    """Possible origin of effort: a joint, or this axis in another unit; `misfit` in squared standard deviations."""

    name: str
    joint: int
    is_unit: bool
    misfit: float


def origins(axis: AxisRecords, found: Sequence[Response]) -> list[Origin]:
    """All origins, the most likely first; empty if no pose determines inertia and weight."""
    # 4.0 standard errors: minimum significance of the inertia
    clear = [one for one in found if one.inertia > 4.0 * one.inertia_error]
    if not clear:
        return []
    inertia = np.array([one.inertia for one in clear])
    resistance = float(np.median([one.resistance for one in clear]))
    poses = np.array([one.record.spec.pose for one in clear])
    weight = weighed(axis, [one.record for one in clear])
    origins: list[Origin] = []
    for joint, swapped, name, factor in _candidates(axis):
        nominal = axis.nominal_inertias(_stood(axis, poses, joint, swapped=swapped), joint)
        if not (nominal > 0).all():
            continue
        off = np.log(inertia / (factor * nominal))
        # 0.2 of that in CAD, standard deviation, common to all poses
        # 0.1 standard deviation between poses
        misfit = (float(off.mean()) / 0.2) ** 2 + (float(off.std()) / 0.1) ** 2
        viscous = axis.robot.axes[joint].viscous_friction
        if viscous and resistance > 0:
            # 0.5 of that in the robot file, as in the prior
            misfit += (np.log(resistance / (factor * viscous)) / 0.5) ** 2
        if weight is not None:
            misfit += _of_weight(axis, joint, weight, factor, swapped=swapped)
        origins.append(Origin(name, joint, factor != 1.0, float(misfit)))
    return sorted(origins, key=lambda one: one.misfit)


def another(axis: AxisRecords, likely: Sequence[Origin]) -> Origin | None:
    """Another axis, if it fits and this one does not in any unit."""
    others = [one for one in likely if one.joint != axis.index]
    own = [one for one in likely if one.joint == axis.index]
    if not others or not own:
        return None
    plain = next(one.misfit for one in own if not one.is_unit)
    sure = others[0].misfit < FITS and own[0].misfit - others[0].misfit > BETTER and plain > REFUSED
    return others[0] if sure else None


def _candidates(axis: AxisRecords) -> Iterator[tuple[int, bool, str, float]]:
    """Joint, whether the entries of the pose are exchanged, name, factor of effort."""
    yield axis.index, False, axis.joint, 1.0
    for name, factor in effort_units(axis).items():
        yield axis.index, False, name, factor
    for k, joint in enumerate(axis.robot.joints):
        if k != axis.index:
            yield k, False, joint, 1.0
            yield k, True, joint, 1.0


def _stood(axis: AxisRecords, poses: Array, joint: int, *, swapped: bool) -> Array:
    """Poses (m, joints); if `swapped`, the entries of both axes are exchanged."""
    order = list(range(poses.shape[1]))
    if swapped:
        order[axis.index], order[joint] = joint, axis.index
    return poses[:, order]


def _of_weight(axis: AxisRecords, joint: int, held: "HoldingEffort", factor: float, *, swapped: bool) -> float:
    """Squared difference of holding effort between CAD and measurement, over the errors of both and of friction."""
    poses = _stood(axis, held.poses, joint, swapped=swapped)
    rows = gravity_rows(axis.robot.chain, axis.robot.gravity, joint, poses)[:, 0]
    carried = axis.robot.counterbalance_effort(joint, poses[:, joint])
    weight = factor * (rows @ axis.robot.chain.inertial.ravel() + carried)
    # 0.2 of the larger of both values
    size = 0.2**2 * float(np.mean(np.maximum(held.effort**2, weight**2))) + held.friction**2
    return float(np.mean((held.effort - weight) ** 2)) / size if size else 0.0


@dataclass(frozen=True)
class HoldingEffort:
    """Mean of both directions at the lowest speed: `poses` (p, joints), holding effort there (p,), N m (N), and half of
    the difference between the directions.
    """

    poses: Array
    effort: Array
    friction: float


def weighed(axis: AxisRecords, records: Sequence[Record]) -> HoldingEffort | None:
    """Values at the poses, from a line fit of effort over position; None if no pose was swept in both directions."""
    start: dict[tuple[float, ...], dict[float, list[float]]] = {}
    slow = min(abs(record.spec.offset_velocity) for record in records)
    for record in records:
        if 0 < abs(record.spec.offset_velocity) <= 1.01 * slow and np.ptp(record.position) > 0:
            off = record.position - record.spec.pose[axis.index]
            line = np.polynomial.Polynomial.fit(off, record.effort, 1)
            ways = start.setdefault(record.spec.pose, {})
            ways.setdefault(float(np.sign(record.spec.offset_velocity)), []).append(float(line(0.0)))
    both = {pose: ways for pose, ways in start.items() if len(ways) > 1}
    if not both:
        return None
    ends = np.array([[np.mean(ways[-1.0]), np.mean(ways[1.0])] for ways in both.values()])
    return HoldingEffort(np.array(list(both)), ends.mean(axis=1), float(np.median(ends[:, 1] - ends[:, 0])) / 2)


OFF = 2.5  # largest factor of a correct axis, above or below CAD
SURE = 4.0  # standard errors
UNIT = np.log(2.2)  # ln of the largest ratio between a unit's factor and the measured one: CAD is no more accurate
RESISTS = 0.15  # of viscous friction in the robot file (prior: 50 %), without dry friction: each axis has more


@dataclass(frozen=True)
class Seen:
    """All records of an axis: apparent inertia over that of CAD, its error, and the sign of the resistance."""

    records: tuple[Response, ...]
    ratios: Array  # (m,)
    ratio: float
    error: float
    brakes: bool

    @property
    def clear(self) -> bool:
        return abs(self.ratio) > SURE * self.error

    @property
    def fits(self) -> bool:
        return self.clear and 1 / OFF < self.ratio < OFF

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(one.record.id for one in self.records)


def seen(axis: AxisRecords, found: Sequence[Response]) -> Seen | None:
    """Means weighted by the errors; None if no record determines the inertia."""
    if not found:
        return None
    nominal = axis.nominal_inertias(np.array([one.record.spec.pose for one in found]))
    if not (nominal > 0).all():
        return None
    ratios = np.array([one.inertia for one in found]) / nominal
    errors = np.array([one.inertia_error for one in found]) / nominal
    # 0.1 of CAD: normal difference between records
    weight = 1 / (errors**2 + (0.1 * np.maximum(np.abs(np.median(ratios)), 1e-6)) ** 2)
    resistance = np.array([one.resistance for one in found])
    by_error = 1 / np.maximum(np.array([one.resistance_error for one in found]), 0.05 * np.abs(resistance) + 1e-12) ** 2
    return Seen(
        tuple(found),
        ratios,
        float(weight @ ratios / weight.sum()),
        float(1 / np.sqrt(weight.sum())),
        float(by_error @ resistance) > 0,
    )


def effort(axis: AxisRecords, all_: Seen | None, *, placed: bool) -> list[DataFinding]:
    """At most one finding, because a factor is meaningless with a wrong sign. `placed`: the position is correct."""
    if all_ is None:
        return []
    likely = origins(axis, all_.records) if placed else []
    in_unit = bool(likely) and likely[0].is_unit and likely[0].misfit < REFUSED
    friction = _friction(axis, all_) if placed and not in_unit and not all_.fits else None
    if friction is not None and abs(friction) < RESISTS:
        return [_still(axis, all_, friction)]
    other = another(axis, likely)
    if other is not None:
        return [_other(axis, all_, other, likely)]
    if all_.fits:
        return []
    if not all_.clear:
        return _unrelated(axis, all_)
    if all_.ratio < 0:
        return [] if all_.brakes else [_sign(axis, all_)]
    return [_size(axis, all_)]


def _friction(axis: AxisRecords, all_: Seen) -> float | None:
    """Resistance over that of the robot file: the larger one from lines and from reversal; None if unknown."""
    nominal, held = axis.axis.viscous_friction, weighed(axis, [one.record for one in all_.records])
    lines = [one for one in all_.records if one.impedance.size]
    if not nominal or held is None or not lines:
        return None
    slow = min(abs(one.record.spec.offset_velocity) for one in lines)
    at_lines = float(np.median(np.concatenate([one.impedance.real for one in lines]))) / nominal
    error = float(np.median([one.resistance_error for one in lines])) / nominal / np.sqrt(len(lines))
    turning = held.friction / (nominal * slow)
    return max(at_lines, turning, key=abs) if SURE * error < RESISTS else None


def _still(axis: AxisRecords, all_: Seen, friction: float) -> DataFinding:
    return DataFinding(
        "wrong_axis", "wrong", axis.joint, all_.ids, friction, RESISTS,
        f"{axis.joint}, {named(all_.ids)}: effort does not answer to the motion: inertia is "
        f"{100 * all_.ratio:.2g} % of CAD's, friction at its lines and turns {100 * abs(friction):.2g} % of the robot "
        f"file's, limit {100 * RESISTS:g} %. The axis that it is of holds still.",
        "Check that the effort channel is of this axis.",
    )  # fmt: skip


def _other(axis: AxisRecords, all_: Seen, other: Origin, likely: Sequence[Origin]) -> DataFinding:
    own = min((one.misfit for one in likely if one.joint == axis.index), default=np.inf)
    return DataFinding(
        "wrong_axis", "wrong", axis.joint, all_.ids, own, FITS,
        f"{axis.joint}, {named(all_.ids)}: inertia, weight and friction are {np.sqrt(own):.2g} standard deviations off "
        f"those of {axis.joint} in any unit, and {np.sqrt(other.misfit):.2g} off those of {other.name} in all poses.",
        f"Check whether these recordings are of {other.name}: the columns, or `axis` and `pose` in bundle.json.",
    )  # fmt: skip


def _sign(axis: AxisRecords, all_: Seen) -> DataFinding:
    value = float(np.median([one.inertia for one in all_.records]))
    unit = "kg" if axis.prismatic else "kg m^2"
    return DataFinding(
        "effort_sign", "wrong", axis.joint, all_.ids, value, 0.0,
        f"{axis.joint}, {named(all_.ids)}: apparent inertia is {value:.4g} {unit} and friction drives the axis: effort "
        "has the wrong sign against velocity.",
        "Reverse the sign of effort (or of position and velocity, if the encoder counts the other way).",
    )  # fmt: skip


def _unrelated(axis: AxisRecords, all_: Seen) -> list[DataFinding]:
    """The inertia of CAD would be visible but is not: the effort does not belong to this motion."""
    if abs(all_.ratio) + SURE * all_.error > 1 / OFF:
        return []
    return [
        DataFinding(
            "wrong_axis", "wrong", axis.joint, all_.ids, all_.ratio, 1 / OFF,
            f"{axis.joint}, {named(all_.ids)}: effort does not answer to the motion: {100 * abs(all_.ratio):.2g} % of "
            "CAD's inertia is seen, and that is noise.",
            "Check that the effort channel is of this axis.",
        )
    ]  # fmt: skip


def _size(axis: AxisRecords, all_: Seen) -> DataFinding:
    value, ids = all_.ratio, all_.ids
    what = f"{axis.joint}, {named(ids)}: apparent inertia is {value:.3g} times CAD's (limits 1/{OFF:g} and {OFF:g})"
    motor = _motor(axis, all_)
    if motor is not None:
        return motor
    far = effort_unit(axis, value, UNIT)
    if far is not None:
        return DataFinding(
            "effort_unit", "wrong", axis.joint, ids, value, OFF,
            f"{what}, as if effort were in {far}.",
            f"Convert effort to {axis.unit} on the joint side.",
        )  # fmt: skip
    return DataFinding(
        "effort_scale", "wrong", axis.joint, ids, value, OFF,
        f"{what}, and no unit explains it.",
        "Check the unit of effort, the URDF's masses and inertias, gear ratio, and that the recording is of this axis.",
    )  # fmt: skip


def _motor(axis: AxisRecords, all_: Seen) -> DataFinding | None:
    """The motor inertia of the robot file is too large, and without it CAD agrees."""
    reflected = axis.axis.reflected_motor_inertia or 0.0
    measured = float(np.median([one.inertia for one in all_.records]))
    loads = np.array([axis.load_inertia(one.record.spec.pose) for one in all_.records])
    links = measured / float(np.median(loads)) if (loads > 0).all() else 0.0
    if not (0 < all_.ratio < 1 and reflected > OFF * measured and 1 / OFF < links < 2 * OFF):
        return None
    return DataFinding(
        "motor_inertia", "wrong", axis.joint, all_.ids, reflected, OFF * measured,
        f"{axis.joint}: the motor's inertia in the robot file makes {reflected:.4g} at the joint (times gear ratio "
        f"squared), but the whole axis shows {measured:.4g}.",
        "Give motor_inertia in kg m^2 on the motor side (1 kg cm^2 = 1e-4 kg m^2).",
    )  # fmt: skip


DELAYS = np.arange(-30e-3, 30.25e-3, 0.25e-3)  # s
SPRINGS = np.geomspace(4.0, 60.0, 60)  # Hz
DAMPING = (0.02, 0.1)


def effort_delay(axis: AxisRecords, found: Sequence[Response]) -> list[DataFinding]:
    """At most one finding, from all records with at least two lines."""
    limit = 5e-3  # s
    some = [one for one in found if len(one.frequency) > 1]
    if not some:
        return []
    late = [np.exp(-2j * np.pi * DELAYS[:, None] * one.frequency) for one in some]
    delays = np.sum([_misfit(one, turn, turn) for one, turn in zip(some, late, strict=True)], axis=0)
    best = int(np.argmin(delays))
    value = float(DELAYS[best])
    # 0.25 of the misfit without delay: a smaller misfit confirms the delay
    if abs(value) < limit or delays[best] > 0.25 * float(delays[np.argmin(np.abs(DELAYS))]):
        return []
    sprung = [_springs(one.frequency) for one in some]
    springs = np.sum([_misfit(one, turn, np.ones_like(turn)) for one, turn in zip(some, sprung, strict=True)], axis=0)
    if springs.min() < 2 * delays[best]:
        return []
    turned = [one.impedance * (1 - turn[best]) for one, turn in zip(some, late, strict=True)]
    # 0.15 of what the delay changes at the lines: play distorts by 0.2 and more, friction beside a delay mostly by less
    if sum(np.sum(one.distortion**2) for one in some) > 0.15**2 * sum(np.sum(np.abs(one) ** 2) for one in turned):
        return []
    ids = tuple(one.record.id for one in some)
    word = "late against" if value > 0 else "ahead of"
    return [
        DataFinding(
            "channel_delay", "wrong", axis.joint, ids, value, limit,
            f"{axis.joint}, {named(ids)}: effort is {1e3 * abs(value):.3g} ms {word} velocity at all lines, limit "
            f"{1e3 * limit:.3g} ms.",
            "Record effort and velocity at one instant, or take the filters' delay out (`sweepid channels`).",
        )
    ]  # fmt: skip


def _springs(frequency: Array) -> Complex:
    """Factors (s, l) of i w J for an inertia behind a spring, for all frequencies and dampings."""
    ratio = frequency / np.repeat(SPRINGS, len(DAMPING))[:, None]
    damping = np.tile(DAMPING, len(SPRINGS))[:, None]
    return 1 / (1 - ratio**2 + 2j * damping * ratio)


def _misfit(one: Response, on_inertia: Complex, on_friction: Complex) -> Array:
    """Weighted sum of squares (m,) of the fit of J and mu to each record; their columns are i w and 1, times (m, l)."""
    # 0.02 of Z: other errors of the rigid model
    weight = 1 / np.hypot(one.error, 0.02 * np.abs(one.impedance))
    a, b = 2j * np.pi * one.frequency * on_inertia * weight, on_friction * weight
    wanted = one.impedance * weight
    aa, bb, ab = np.sum(np.abs(a) ** 2, -1), np.sum(np.abs(b) ** 2, -1), np.sum((a.conj() * b).real, -1)
    az, bz = np.sum((a.conj() * wanted).real, -1), np.sum((b.conj() * wanted).real, -1)
    explained = (bb * az**2 - 2 * ab * az * bz + aa * bz**2) / (aa * bb - ab**2)
    return np.asarray(np.sum(np.abs(wanted) ** 2) - explained, dtype=float)
