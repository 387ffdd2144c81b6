r"""Mass, centre and inertia of a payload on the last link, with their uncertainty.

The information (`payloads.sweeps`, `payloads.motion`) is linear in the body's ten parameters phi in the last joint's
frame, [m, m c, I at the origin]. A parameter that is not excited keeps the spread of `WIDE` and is reported as not
excited: a standard deviation above half of the natural size (of m the mass itself, of c `LENGTH`, of I m LENGTH^2).
Mass, centre and inertia about it follow with the Jacobian's spread.

A wrong torque constant scales the values from its axis: `std_total` includes the uncertainty of its prior or calibrated
gain. The body is physical if its pseudo-inertia is positive definite (`physical_consistency`); else the most probable
physical one is given as well, with its distance in standard deviations.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.axis.nominal_priors import TorqueGain, uncalibrated
from service.identification.model.least_squares import Information
from service.identification.model.physical_consistency import Ended, is_physical, nearest_physical
from service.identification.motion.free_motion import free_motions
from service.identification.payloads.motion import motion_evidence
from service.identification.payloads.sweeps import BODY, BodyEvidence, sweep_evidence
from service.model.errors import BadInput
from service.model.recording import Sweep
from service.model.robot import Robot
from service.model.urdf import inertia_matrix, inertia_vector

Array = NDArray[np.float64]

WIDE = np.array([1e3, *3 * [1e3], *6 * [1e3]])  # kg, kg m, kg m^2: one sigma of unknown parameters
LENGTH = 0.3  # m, of a payload
STEP, LEAST_SIZE = 1e-6, 1e-3  # relative step of central differences, and least size that it is relative to
LIGHTEST_PAYLOAD = 0.02  # of the heaviest link: least mass used for natural sizes
NEAREST_SPREAD = 1.0  # relative spread of the compact body near which the physical one is searched


@dataclass(frozen=True)
class Payload:
    """phi (10,) with its covariance (10, 10), conditional on the torque constants and in total; the same of [m, c, I
    about c].

    `excited` (10,) of the latter. `nearest` (10,): phi of the most probable physical body, `deviation` its distance in
    standard deviations, `ended` how its search ended. `evidence` by axis.
    """

    parameters: Array
    covariance: Array
    covariance_total: Array
    body: Array
    body_std: Array
    body_std_total: Array
    excited: NDArray[np.bool_]
    physical: bool
    nearest: Array
    deviation: float
    ended: Ended
    evidence: tuple[BodyEvidence, ...]


def payload(
    robot: Robot, before: Sequence[Sweep], after: Sequence[Sweep], gains: Mapping[str, TorqueGain] | None = None
) -> Payload:
    """The body that is mounted in `after` and not in `before`; `gains` calibrated by joint. BadInput without common
    motions, and where no effort differs.
    """
    known = gains or {}
    values = {joint: one.gain for joint, one in known.items()}
    evidence = [
        *sweep_evidence(robot, before, after, values),
        *motion_evidence(robot, free_motions(robot, before), free_motions(robot, after), values),
    ]
    if not evidence:
        raise BadInput("payload", "no sweep in the same pose and no motion of several axes is in both bundles")
    spread = [one.std / one.gain for one in (known.get(joint) or uncalibrated(robot) for joint in robot.joints)]
    return _solve(robot, evidence, np.array(spread))


def body_of(parameters: Array) -> Array:
    """[m, mc, I at the origin] -> [m, c, I about c], (10,) each."""
    mass = parameters[0]
    centre = parameters[1:4] / mass
    about = inertia_matrix(parameters) - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.concatenate([[mass], centre, inertia_vector(about)])


def _solve(robot: Robot, evidence: Sequence[BodyEvidence], gain_spread: Array) -> Payload:
    information = Information.empty(BODY).add(np.eye(BODY), np.zeros(BODY), np.diag(WIDE**2))
    for each in evidence:
        information = information.plus(each.information)
    solution = information.solve(np.zeros(BODY))
    if not solution.values[0]:
        raise BadInput("payload", "no effort differs between the bundles: name one without the payload and one with it")
    by_gain = solution.covariance @ sum((each.gain_vector for each in evidence), np.zeros((BODY, len(robot.axes))))
    total = solution.covariance + (by_gain * gain_spread**2) @ by_gain.T
    jacobian = _jacobian(body_of, solution.values)
    body, (std, std_total) = body_of(solution.values), (_std(jacobian, c) for c in (solution.covariance, total))
    mass = max(abs(solution.values[0]), LIGHTEST_PAYLOAD * float(robot.chain.inertial[:, 0].max()))
    size = np.array([mass, *3 * [LENGTH], *6 * [mass * LENGTH**2]])
    nearest, deviation, ended = _physical(solution.values, solution.covariance, mass)
    return Payload(
        parameters=solution.values,
        covariance=solution.covariance,
        covariance_total=total,
        body=body,
        body_std=std,
        body_std_total=std_total,
        excited=std < size / 2,
        physical=bool(is_physical(solution.values)),
        nearest=nearest,
        deviation=deviation,
        ended=ended,
        evidence=tuple(evidence),
    )


def _physical(values: Array, covariance: Array, mass: float) -> tuple[Array, float, Ended]:
    """The physical body that agrees best, near a compact one where nothing was excited; its distance, how it ended."""
    centre = np.clip(values[1:4] / mass, -LENGTH, LENGTH)
    compact = mass * (LENGTH / 2) ** 2 * np.eye(3) + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    nominal = np.concatenate([[mass], mass * centre, inertia_vector(compact), [0.0]])
    rows = np.hstack([np.eye(BODY), np.zeros((BODY, 1))])
    found = nearest_physical(nominal, (NEAREST_SPREAD, np.ones(1)), rows, values, covariance)
    return found.parameters[:BODY], found.deviation, found.ended


def _std(jacobian: Array, covariance: Array) -> Array:
    return np.sqrt(np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian))


def _jacobian(function: Callable[[Array], Array], at: Array) -> Array:
    """By central differences, (10, 10)."""
    steps = STEP * np.maximum(np.abs(at), LEAST_SIZE)
    columns = [(function(at + h) - function(at - h)) / (2 * s) for s, h in zip(steps, np.diag(steps), strict=True)]
    return np.stack(columns, -1)
