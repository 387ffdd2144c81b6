"""The nominal model of the whole dynamics, (14 n,) parameters as in `inverse_dynamics`, and its uncertainty.

What no data sheet gives may be anything that the measured efforts allow: an unknown rotor behind its gear can be 500
times as heavy as the wrist that it turns, so the model of the links says nothing about it (`Scale`).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.model.base_parameters import BaseParameters, joint_ranges
from service.identification.model.least_squares import Information
from service.identification.model.regressor import inertia_rows
from service.model.robot import Robot

Array = NDArray[np.float64]

COULOMB_PRIOR, OFFSET_PRIOR = 0.1, 0.02  # of the rated effort: one sigma of values that are in no data sheet
RATED = 3.0  # times the RMS effort of a motion that is measured, in place of the rated effort
LEAST_MASS, LEAST_RADIUS = 1e-9, 1e-3  # kg, m: of a link, so that no parameter is certain
DRY_FRICTION_OPEN = 10.0  # times these values is the prior of dry friction in the fit


@dataclass(frozen=True)
class Scale:
    """Size of the measurements of an axis, all positive, and the largest values that they allow; None where nothing was
    measured.
    """

    inertia: float | None = None  # kg m^2 (kg)
    viscous: float | None = None  # N m s/rad (N s/m)
    effort: float | None = None  # N m (N), RMS
    speed: float | None = None  # rad/s (m/s), the highest


def nominal_parameters(robot: Robot) -> Array:
    """The model's (14 n,): links of CAD, motors and viscous friction of the data sheets; dry friction is unknown."""
    motors = [axis.reflected_motor_inertia or 0.0 for axis in robot.axes]
    viscous = [axis.viscous_friction or 0.0 for axis in robot.axes]
    return np.concatenate([robot.chain.inertial.ravel(), motors, viscous, np.zeros(2 * len(robot.axes))])


def link_sizes(links: Array, lightest: float = 0.0) -> Array:
    """Natural sizes (10 n,) of the parameters of links (n, 10): m, m r and m r^2 for mass, first and second moments.

    r: radius of gyration, m. `lightest`, kg: least mass.
    """
    mass = np.maximum(links[:, :1], max(lightest, LEAST_MASS))
    radius = np.sqrt(np.maximum(links[:, [4, 6, 9]].sum(-1, keepdims=True), 0) / 2 / mass) + LEAST_RADIUS
    return np.hstack([mass, np.repeat(mass * radius, 3, 1), np.repeat(mass * radius**2, 6, 1)]).ravel()


def parameter_spread(robot: Robot, scales: Mapping[str, Scale] | None = None) -> Array:
    """Standard deviations (14 n,). For values without data sheet those of `scales`, by joint; where nothing was
    measured, the inertia that a motor moves, and the rated effort at the joint's highest speed.
    """
    size = link_sizes(robot.chain.inertial)
    prior = robot.prior
    measured = [(scales or {}).get(axis.joint, Scale()) for axis in robot.axes]
    rated = np.array(
        [
            RATED * one.effort if one.effort else axis.rated_effort
            for axis, one in zip(robot.axes, measured, strict=True)
        ]
    )
    motors = [
        prior.motor_inertia * axis.reflected_motor_inertia
        if axis.reflected_motor_inertia
        else measured[k].inertia or _moved(robot, k)
        for k, axis in enumerate(robot.axes)
    ]
    speeds = [
        joint.velocity if np.isfinite(joint.velocity) and joint.velocity > 0 else 1.0 for joint in robot.chain.joints
    ]
    viscous = [
        prior.viscous_friction * axis.viscous_friction
        if axis.viscous_friction
        else one.viscous or axis.rated_effort / speed
        for axis, speed, one in zip(robot.axes, speeds, measured, strict=True)
    ]
    return np.concatenate([prior.inertia * size, motors, viscous, COULOMB_PRIOR * rated, OFFSET_PRIOR * rated])


def prior_information(robot: Robot, base: BaseParameters, scales: Mapping[str, Scale] | None = None) -> Information:
    """The prior of the base parameters (r,) as a measurement of them; dry friction has a wide prior."""
    spread = parameter_spread(robot, scales)
    spread[12 * len(robot.axes) :] *= DRY_FRICTION_OPEN
    covariance = (base.combination * spread**2) @ base.combination.T
    start = base.combination @ nominal_parameters(robot)
    return Information.empty(len(start)).add(np.eye(len(start)), start, covariance)


def _moved(robot: Robot, index: int) -> float:
    """Inertia of the links about an axis in the middle of all ranges, kg m^2 (kg)."""
    pose = np.mean(joint_ranges(robot.chain), axis=0)
    return float((inertia_rows(robot.chain, index, pose[None]) @ robot.chain.inertial.ravel())[0])
