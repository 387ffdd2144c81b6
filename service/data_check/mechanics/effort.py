"""Effort compared with motion: its sign, its unit, and whether it belongs to this axis.

Two signs are checked at the lowest line: inertia torque is in phase with acceleration, friction torque in phase with
velocity. If both are reversed, the sign of effort is wrong. The size is compared with CAD: all moving links and the
motor. Model errors within the prior, a payload, and a spring of 5 Hz stay within `OFF`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.data_check.finding import Finding, named
from service.data_check.mechanics.other_axis import FITS, REFUSED, Origin, another, origins, weighed
from service.data_check.mechanics.response import Response
from service.data_check.record import AxisRecords
from service.data_check.units import effort_unit
from service.model.recording import Array

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


def effort(axis: AxisRecords, all_: Seen | None, *, placed: bool) -> list[Finding]:
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


def _still(axis: AxisRecords, all_: Seen, friction: float) -> Finding:
    return Finding(
        "wrong_axis", "wrong", axis.joint, all_.ids, friction, RESISTS,
        f"{axis.joint}, {named(all_.ids)}: effort does not answer to the motion: inertia is "
        f"{100 * all_.ratio:.2g} % of CAD's, friction at its lines and turns {100 * abs(friction):.2g} % of the robot "
        f"file's, limit {100 * RESISTS:g} %. The axis that it is of holds still.",
        "Check that the effort channel is of this axis.",
    )  # fmt: skip


def _other(axis: AxisRecords, all_: Seen, other: Origin, likely: Sequence[Origin]) -> Finding:
    own = min((one.misfit for one in likely if one.joint == axis.index), default=np.inf)
    return Finding(
        "wrong_axis", "wrong", axis.joint, all_.ids, own, FITS,
        f"{axis.joint}, {named(all_.ids)}: inertia, weight and friction are {np.sqrt(own):.2g} standard deviations off "
        f"those of {axis.joint} in any unit, and {np.sqrt(other.misfit):.2g} off those of {other.name} in all poses.",
        f"Check whether these recordings are of {other.name}: the columns, or `axis` and `pose` in bundle.json.",
    )  # fmt: skip


def _sign(axis: AxisRecords, all_: Seen) -> Finding:
    value = float(np.median([one.inertia for one in all_.records]))
    unit = "kg" if axis.prismatic else "kg m^2"
    return Finding(
        "effort_sign", "wrong", axis.joint, all_.ids, value, 0.0,
        f"{axis.joint}, {named(all_.ids)}: apparent inertia is {value:.4g} {unit} and friction drives the axis: effort "
        "has the wrong sign against velocity.",
        "Reverse the sign of effort (or of position and velocity, if the encoder counts the other way).",
    )  # fmt: skip


def _unrelated(axis: AxisRecords, all_: Seen) -> list[Finding]:
    """The inertia of CAD would be visible but is not: the effort does not belong to this motion."""
    if abs(all_.ratio) + SURE * all_.error > 1 / OFF:
        return []
    return [
        Finding(
            "wrong_axis", "wrong", axis.joint, all_.ids, all_.ratio, 1 / OFF,
            f"{axis.joint}, {named(all_.ids)}: effort does not answer to the motion: {100 * abs(all_.ratio):.2g} % of "
            "CAD's inertia is seen, and that is noise.",
            "Check that the effort channel is of this axis.",
        )
    ]  # fmt: skip


def _size(axis: AxisRecords, all_: Seen) -> Finding:
    value, ids = all_.ratio, all_.ids
    what = f"{axis.joint}, {named(ids)}: apparent inertia is {value:.3g} times CAD's (limits 1/{OFF:g} and {OFF:g})"
    motor = _motor(axis, all_)
    if motor is not None:
        return motor
    far = effort_unit(axis, value, UNIT)
    if far is not None:
        return Finding(
            "effort_unit", "wrong", axis.joint, ids, value, OFF,
            f"{what}, as if effort were in {far}.",
            f"Convert effort to {axis.unit} on the joint side.",
        )  # fmt: skip
    return Finding(
        "effort_scale", "wrong", axis.joint, ids, value, OFF,
        f"{what}, and no unit explains it.",
        "Check the unit of effort, the URDF's masses and inertias, gear ratio, and that the recording is of this axis.",
    )  # fmt: skip


def _motor(axis: AxisRecords, all_: Seen) -> Finding | None:
    """The motor inertia of the robot file is too large, and without it CAD agrees."""
    reflected = axis.axis.reflected_motor_inertia or 0.0
    measured = float(np.median([one.inertia for one in all_.records]))
    loads = np.array([axis.load_inertia(one.record.spec.pose) for one in all_.records])
    links = measured / float(np.median(loads)) if (loads > 0).all() else 0.0
    if not (0 < all_.ratio < 1 and reflected > OFF * measured and 1 / OFF < links < 2 * OFF):
        return None
    return Finding(
        "motor_inertia", "wrong", axis.joint, all_.ids, reflected, OFF * measured,
        f"{axis.joint}: the motor's inertia in the robot file makes {reflected:.4g} at the joint (times gear ratio "
        f"squared), but the whole axis shows {measured:.4g}.",
        "Give motor_inertia in kg m^2 on the motor side (1 kg cm^2 = 1e-4 kg m^2).",
    )  # fmt: skip
