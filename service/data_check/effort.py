"""Effort against motion: its sign, its unit, and whether it is of this axis at all.

Two signs must be right at the lowest line: inertia takes effort in phase with acceleration, friction in phase with
velocity. Both reversed: the sign of effort. The size is compared with CAD, all that moves and the motor; a model within
its prior, a payload, and a spring of 5 Hz stay within `OFF`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.data_check.finding import Finding, named
from service.data_check.record import AxisRecords
from service.data_check.response import Response
from service.data_check.units import effort_unit
from service.recording import Array

OFF = 2.5  # factor to either side of CAD that a sound axis keeps
SURE = 4.0  # standard errors
MODEL = 0.1  # of CAD: by how much records differ anyway
UNIT = np.log(2.2)  # how far a unit's factor may be from what is found: CAD is no better
ALIKE = np.log(1.4)  # how near is near: another axis' CAD in every pose, or a unit that comes before another axis


@dataclass(frozen=True)
class Seen:
    """All records of an axis together: apparent inertia over CAD's, its error, and the sign of the resistance."""

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
    """Weighted by their errors; None where nothing tells inertia."""
    if not found:
        return None
    nominal = np.array([axis.nominal_inertia(one.record.spec.pose) for one in found])
    if not (nominal > 0).all():
        return None
    ratios = np.array([one.inertia for one in found]) / nominal
    errors = np.array([one.inertia_error for one in found]) / nominal
    weight = 1 / (errors**2 + (MODEL * np.maximum(np.abs(np.median(ratios)), 1e-6)) ** 2)
    resistance = np.array([one.resistance for one in found])
    by_error = 1 / np.maximum(np.array([one.resistance_error for one in found]), 0.05 * np.abs(resistance) + 1e-12) ** 2
    return Seen(
        tuple(found),
        ratios,
        float(weight @ ratios / weight.sum()),
        float(1 / np.sqrt(weight.sum())),
        float(by_error @ resistance) > 0,
    )


def effort(axis: AxisRecords, all_: Seen | None) -> list[Finding]:
    """At most one finding: a wrong sign would make any factor meaningless."""
    if all_ is None or all_.fits:
        return []
    if not all_.clear:
        return _unrelated(axis, all_)
    if all_.ratio < 0:
        return [] if all_.brakes else [_sign(axis, all_)]
    return [_size(axis, all_)]


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
    """No inertia is seen where CAD's would have been: effort knows nothing of this motion."""
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
    near, far, other = (
        effort_unit(axis, value, ALIKE), effort_unit(axis, value, UNIT), _other_axis(axis, all_),
    )  # fmt: skip
    if other is not None and near is None:
        return Finding(
            "wrong_axis", "wrong", axis.joint, ids, value, OFF,
            f"{what}; it fits {other} in every pose.",
            f"Check whether these recordings are of {other}.",
        )  # fmt: skip
    if far is not None:
        return Finding(
            "effort_unit", "wrong", axis.joint, ids, value, OFF,
            f"{what}, as if effort were in {near or far}.",
            f"Convert effort to {axis.unit} on the joint side.",
        )  # fmt: skip
    return Finding(
        "effort_scale", "wrong", axis.joint, ids, value, OFF,
        f"{what}, and no unit explains it.",
        "Check the unit of effort, the URDF's masses and inertias, gear ratio, and that the recording is of this axis.",
    )  # fmt: skip


def _motor(axis: AxisRecords, all_: Seen) -> Finding | None:
    """The robot file's motor alone is too much, and without it CAD would do."""
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


def _other_axis(axis: AxisRecords, all_: Seen) -> str | None:
    """A joint whose CAD inertia fits the clear records in every pose."""
    clear = [one for one in all_.records if one.inertia > SURE * one.inertia_error]
    for k, joint in enumerate(axis.robot.joints):
        theirs = [one.inertia / axis.nominal_inertia(one.record.spec.pose, k) for one in clear]
        if k != axis.index and theirs and float(np.max(np.abs(np.log(theirs)))) < ALIKE:
            return joint
    return None
