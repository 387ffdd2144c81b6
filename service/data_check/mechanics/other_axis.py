"""Whose effort is it? Inertia, weight and friction in all poses, of this axis in any unit and of every other axis.

Of another axis either the pose is told as it stood, or its entry and this axis' have changed places with the columns.
CAD is off by some tens of per cent, so is friction; a unit or another axis is off by more, or does not fit every pose.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from service.data_check.mechanics.response import Response
from service.data_check.record import AxisRecords, Record
from service.data_check.units import effort_units
from service.identification.model.regressor import gravity_rows
from service.recording import Array

SURE = 4.0  # standard errors by which inertia must be seen
INERTIA = 0.2  # of CAD's, standard deviation, all poses alike
SHAPE = 0.1  # from pose to pose
WEIGHT = 0.2  # of the larger of both
FRICTION = 0.5  # of the robot file's, the prior's
FITS = float(chi2.ppf(0.99, 3))  # of three numbers
BETTER = 9.2  # by how much: a hundred times as likely, -2 ln
REFUSED = 25.0  # so unlikely must SI of this axis be: five standard deviations, as loads and springs are no faults


@dataclass(frozen=True)
class Origin:
    """Where effort may come from: a joint, or this axis' in a unit; `misfit` in squares of standard deviations."""

    name: str
    joint: int
    is_unit: bool
    misfit: float


def origins(axis: AxisRecords, found: Sequence[Response]) -> list[Origin]:
    """Every one, the likeliest first; empty where no pose tells inertia and weight."""
    clear = [one for one in found if one.inertia > SURE * one.inertia_error]
    if not clear:
        return []
    inertia = np.array([one.inertia for one in clear])
    resistance = float(np.median([one.resistance for one in clear]))
    poses = np.array([one.record.spec.pose for one in clear])
    weight = weighed(axis, [one.record for one in clear])
    told: list[Origin] = []
    for joint, swapped, name, factor in _candidates(axis):
        nominal = axis.nominal_inertias(_stood(axis, poses, joint, swapped=swapped), joint)
        if not (nominal > 0).all():
            continue
        off = np.log(inertia / (factor * nominal))
        misfit = (float(off.mean()) / INERTIA) ** 2 + (float(off.std()) / SHAPE) ** 2
        viscous = axis.robot.axes[joint].viscous_friction
        if viscous and resistance > 0:
            misfit += (np.log(resistance / (factor * viscous)) / FRICTION) ** 2
        if weight is not None:
            misfit += _of_weight(axis, joint, weight, factor, swapped=swapped)
        told.append(Origin(name, joint, factor != 1.0, float(misfit)))
    return sorted(told, key=lambda one: one.misfit)


def another(axis: AxisRecords, likely: Sequence[Origin]) -> Origin | None:
    """Another axis, where it fits, this one does not, and none of its units comes near."""
    others = [one for one in likely if one.joint != axis.index]
    own = [one for one in likely if one.joint == axis.index]
    if not others or not own:
        return None
    plain = next(one.misfit for one in own if not one.is_unit)
    sure = others[0].misfit < FITS and own[0].misfit - others[0].misfit > BETTER and plain > REFUSED
    return others[0] if sure else None


def _candidates(axis: AxisRecords) -> Iterator[tuple[int, bool, str, float]]:
    """Joint, whether its pose has changed places, name, factor of effort."""
    yield axis.index, False, axis.joint, 1.0
    for name, factor in effort_units(axis).items():
        yield axis.index, False, name, factor
    for k, joint in enumerate(axis.robot.joints):
        if k != axis.index:
            yield k, False, joint, 1.0
            yield k, True, joint, 1.0


def _stood(axis: AxisRecords, poses: Array, joint: int, *, swapped: bool) -> Array:
    """Poses (m, joints), with the entries of both axes in each other's place if `swapped`."""
    order = list(range(poses.shape[1]))
    if swapped:
        order[axis.index], order[joint] = joint, axis.index
    return poses[:, order]


def _of_weight(axis: AxisRecords, joint: int, held: "Weighed", factor: float, *, swapped: bool) -> float:
    """How far CAD's holding effort is off what was held, squared, in parts of what both may be wrong; friction adds."""
    poses = _stood(axis, held.poses, joint, swapped=swapped)
    rows = gravity_rows(axis.robot.chain, axis.robot.gravity, joint, poses)[:, 0]
    weight = factor * (rows @ axis.robot.chain.inertial.ravel())
    size = WEIGHT**2 * float(np.mean(np.maximum(held.effort**2, weight**2))) + held.friction**2
    return float(np.mean((held.effort - weight) ** 2)) / size if size else 0.0


@dataclass(frozen=True)
class Weighed:
    """Between both directions at the slowest: `poses` (p, joints), what effort holds there (p,), N m (N), and half of
    what it differs by.
    """

    poses: Array
    effort: Array
    friction: float


def weighed(axis: AxisRecords, records: Sequence[Record]) -> Weighed | None:
    """At the poses themselves, by a line of effort over position; None where no pose was swept in both directions."""
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
    return Weighed(np.array(list(both)), ends.mean(axis=1), float(np.median(ends[:, 1] - ends[:, 0])) / 2)
