"""Which axis has this effort? Compares inertia, weight and friction in all poses with this axis in each unit and with
the other axes. For another axis, the recorded pose is used as it is, or with the entries of both axes exchanged.
Of another axis either the pose is told as it stood, or its entry and this axis' have changed places with the columns.
Errors of CAD and of friction are some tens of per cent. A wrong unit or axis gives more, or does not fit all poses.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from service.data_check.mechanics.response import Response
from service.data_check.record import AxisRecords, Record
from service.data_check.units import effort_units
from service.identification.model.regressor import gravity_rows
from service.model.recording import Array

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


def _of_weight(axis: AxisRecords, joint: int, held: "Weighed", factor: float, *, swapped: bool) -> float:
    """Squared difference of holding effort between CAD and measurement, over the errors of both and of friction."""
    poses = _stood(axis, held.poses, joint, swapped=swapped)
    rows = gravity_rows(axis.robot.chain, axis.robot.gravity, joint, poses)[:, 0]
    weight = factor * (rows @ axis.robot.chain.inertial.ravel())
    # 0.2 of the larger of both values
    size = 0.2**2 * float(np.mean(np.maximum(held.effort**2, weight**2))) + held.friction**2
    return float(np.mean((held.effort - weight) ** 2)) / size if size else 0.0


@dataclass(frozen=True)
class Weighed:
    """Mean of both directions at the lowest speed: `poses` (p, joints), holding effort there (p,), N m (N), and half of
    the difference between the directions.
    """

    poses: Array
    effort: Array
    friction: float


def weighed(axis: AxisRecords, records: Sequence[Record]) -> Weighed | None:
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
    return Weighed(np.array(list(both)), ends.mean(axis=1), float(np.median(ends[:, 1] - ends[:, 0])) / 2)
