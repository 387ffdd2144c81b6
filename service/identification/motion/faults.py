r"""Faults of the records of free motions, where the whole inverse dynamics fits them badly.

Each hypothesis changes the records or the robot file: the efforts of two axes are exchanged, all efforts are late, or
gravity has another direction. The simple estimator (`choice`), which knows no nominal model, then predicts
held-out parts. A hypothesis that leaves less than `LEFT` of the error of its axes is told, with the evidence and what
to change. A wrong sign of an effort needs no hypothesis: its Coulomb friction is negative.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from service.identification.model.base_parameters import BaseParameters
from service.identification.model.parameter_prior import Scale, nominal_parameters, prior_information
from service.identification.model.whole_base import dynamic_base
from service.identification.motion.choice import OPEN, wider
from service.identification.motion.equations import AxisEquations, all_equations
from service.identification.motion.fit import fit_equations
from service.identification.motion.free_motion import FreeMotion
from service.identification.motion.held_out import held_out_errors
from service.model.robot import Robot

Array = NDArray[np.float64]

BAD = 0.25  # of the RMS effort: held-out error of an axis from which its records are questioned
LEFT = 0.5  # of the error: most that a fault leaves of it when it is mended
LAGS = np.arange(-0.3, 0.301, 0.05)  # s
STANDARD = 9.81  # m/s^2, where the robot file has no gravity
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class _Hypothesis:
    """`parts` as they would be without the fault; `joints` that it is about; `told` with the next step."""

    robot: Robot
    base: BaseParameters
    parts: list[AxisEquations]
    joints: tuple[str, ...]
    told: str


def faults(
    robot: Robot,
    base: BaseParameters,
    records: Sequence[FreeMotion],
    of: Mapping[str, Scale],
    least: Mapping[str, float],
) -> tuple[str, ...]:
    """The most certain, or none; `least`: held-out errors of the fit, `of`: `choice.scales`."""
    if all(error < BAD * (of[joint].effort or np.inf) for joint, error in least.items() if joint in of):
        return ()
    found: list[tuple[float, str]] = []
    for one in _hypotheses(robot, base, records):
        errors = _errors(one, records, of)
        left = float(np.exp(np.mean([np.log(errors[joint] / least[joint]) for joint in one.joints])))
        if left < LEFT:
            found.append((left, f"{one.told}: the held-out error falls to {100 * left:.0f} %"))
    return tuple(told for _, told in sorted(found)[:1])


def _errors(one: _Hypothesis, records: Sequence[FreeMotion], of: Mapping[str, Scale]) -> dict[str, float]:
    start = one.base.combination @ nominal_parameters(one.robot)
    prior = wider(prior_information(one.robot, one.base, of), OPEN)
    return held_out_errors(fit_equations(one.robot, records, one.parts, prior, start, order=0), prior, start)


def _hypotheses(robot: Robot, base: BaseParameters, records: Sequence[FreeMotion]) -> Iterator[_Hypothesis]:
    parts = all_equations(robot, base, records)
    joints = tuple(dict.fromkeys(each.joint for each in parts))
    efforts = {(each.record, each.joint): each.values for each in parts}
    for pair in combinations(joints, 2):
        other = dict(zip(pair, reversed(pair), strict=True))
        if all((each.record, other[each.joint]) in efforts for each in parts if each.joint in pair):
            exchanged = [
                replace(each, values=efforts[each.record, other[each.joint]]) if each.joint in pair else each
                for each in parts
            ]
            told = f"the efforts of {pair[0]} and {pair[1]} seem to be exchanged: exchange their columns"
            yield _Hypothesis(robot, base, exchanged, pair, told)
    for lag in LAGS[np.abs(LAGS) > 0.01].tolist():
        shifted = [replace(each, values=np.interp(each.time + lag, each.time, each.values)) for each in parts]
        told = f"the efforts seem to be {1000 * lag:.0f} ms late: take them earlier by that"
        yield _Hypothesis(robot, base, shifted, joints, told)
    size = float(np.linalg.norm(robot.gravity)) or STANDARD
    oblique = dynamic_base(_turned(robot, (size, size, size)))  # of any direction: none makes a column vanish
    for axis in range(3):
        for sign in (1.0, -1.0):
            gravity = [0.0, 0.0, 0.0]
            gravity[axis] = sign * size
            if np.allclose(gravity, robot.gravity, atol=0.1 * size):
                continue
            turned = _turned(robot, (gravity[0], gravity[1], gravity[2]))
            told = f'gravity seems to act along {"-" if sign < 0 else ""}{AXES[axis]} of the base: set "gravity"'
            yield _Hypothesis(turned, oblique, all_equations(turned, oblique, records), joints, told)


def _turned(robot: Robot, gravity: tuple[float, float, float]) -> Robot:
    return replace(robot, description=robot.description.model_copy(update={"gravity": gravity}))
