r"""Information on a payload from the same motions of all axes before and after mounting it on the last link.

    effort_after - effort_before = (rows of the last link) phi + change of friction

at every instant, for every axis: the robot itself cancels, and with it the error of its model. Small differences of
the paths are corrected by the model from the motions before; viscous friction, dry friction and offset of each axis may
have changed between the runs. Filter, whitening and covariance are those of `motion.fit`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.identification.model.base_parameters import BaseParameters
from service.identification.model.inverse_dynamics import dynamics_names
from service.identification.model.least_squares import Information
from service.identification.model.parameter_prior import nominal_parameters, prior_information
from service.identification.model.whole_base import dynamic_base
from service.identification.motion.along_motion import whole_parameters
from service.identification.motion.equations import AxisEquations, equations
from service.identification.motion.fit import fit_equations, fit_free_motions
from service.identification.motion.free_motion import FreeMotion, calibrated
from service.identification.payloads.sweeps import BODY, BodyEvidence, last_link
from service.model.errors import BadInput
from service.model.robot import Robot

Array = NDArray[np.float64]

SAME_PATH = 0.05  # allowed relative difference of the paths: a loaded axis has a larger following error
LATE = 2.0  # s, maximum difference of the starts of two records within the motion


def motion_evidence(
    robot: Robot, before: Sequence[FreeMotion], after: Sequence[FreeMotion], gains: Mapping[str, float]
) -> list[BodyEvidence]:
    """For every motion that was run both before and after. Raises BadInput if there are motions, but none in both."""
    both = [match for loaded in after if (match := _match(before, loaded)) is not None]
    if not both:
        if before and after:
            raise BadInput("payload", "no motion was run both before and after: the same program, block and axes")
        return []
    pairs = [(calibrated(one, gains), calibrated(other, gains)) for one, other in both]
    empty, loaded = [one for one, _ in pairs], [other for _, other in pairs]
    base = dynamic_base(robot)
    start, prior = base.combination @ nominal_parameters(robot), prior_information(robot, base)
    fit = fit_free_motions(robot, base, empty, prior, start)
    known = whole_parameters(robot, base, fit.evidence.honest.plus(prior).solve(start).values)
    parts = [
        each for k, pair in enumerate(zip(empty, loaded, strict=True)) for each in _differences(robot, known, *pair, k)
    ]
    found = fit_equations(robot, loaded, parts, Information.empty(BODY), np.zeros(BODY))
    source = ", ".join(f"{one.ids[0]} and {other.ids[0]}" for one, other in both)
    return [BodyEvidence("all axes", found.evidence.honest, found.evidence.gain_vector, source)]


def _match(before: Sequence[FreeMotion], loaded: FreeMotion) -> tuple[FreeMotion, FreeMotion] | None:
    """The first record of the same motion, both cut to their common part; None if there is none."""
    for one in before:
        if (one.joints, one.rate, one.block) == (loaded.joints, loaded.rate, loaded.block):
            pair = _aligned(one, loaded)
            if pair[0].same_motion(pair[1], SAME_PATH):
                return pair
    return None


def _aligned(one: FreeMotion, other: FreeMotion) -> tuple[FreeMotion, FreeMotion]:
    """Both without the part before the later start: the shift at which their paths differ least."""
    most = min(round(LATE * one.rate), len(one.position) // 4, len(other.position) // 4)
    shifts = range(-most, most + 1)
    apart = [_apart(one.position, other.position, shift, most) for shift in shifts]
    shift = shifts[int(np.argmin(apart))]
    first, second = _from(one, max(shift, 0)), _from(other, max(-shift, 0))
    length = min(len(first.position), len(second.position))
    return _until(first, length), _until(second, length)


def _apart(one: Array, other: Array, shift: int, margin: int) -> float:
    length = min(len(one), len(other)) - margin
    a, b = one[max(shift, 0) :][:length:5], other[max(-shift, 0) :][:length:5]
    count = min(len(a), len(b))
    return float(np.mean((a[:count] - b[:count]) ** 2))


def _from(record: FreeMotion, first: int) -> FreeMotion:
    return _part(record, slice(first, None))


def _until(record: FreeMotion, length: int) -> FreeMotion:
    return _part(record, slice(0, length))


def _part(record: FreeMotion, part: slice) -> FreeMotion:
    return replace(
        record,
        effort=record.effort[part],
        position=record.position[part],
        load_position={joint: column[part] for joint, column in record.load_position.items()},
        load_velocity={joint: column[part] for joint, column in record.load_velocity.items()},
    )


def _differences(robot: Robot, known: Array, empty: FreeMotion, loaded: FreeMotion, number: int) -> list[AxisEquations]:
    """Equations in the body's ten parameters from one pair of records; friction of the axis may have changed."""
    count = len(robot.axes)
    names = dynamics_names(robot.chain)
    everything = BaseParameters(names, tuple(range(len(names))), np.eye(len(names)))
    by_joint = {each.joint: each for each in equations(robot, everything, empty, number)}
    found: list[AxisEquations] = []
    for each in equations(robot, everything, loaded, number):
        other = by_joint.get(each.joint)
        if other is None:
            continue
        friction = [part * count + robot.index(each.joint) for part in (11, 12, 13)]
        found.append(
            replace(
                each,
                rows=each.rows[:, last_link(robot)],
                values=each.values - other.values - (each.rows - other.rows) @ known,
                ripple=np.hstack([each.rows[:, friction], each.ripple, other.ripple]),
                sound=each.sound & other.sound,
            )
        )
    return found
