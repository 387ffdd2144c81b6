"""What is known before anything is measured: the data sheet's drive train, the nominal model, the torque constant."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.frequency_response import Spectrum
from service.identification.joint_fit import PosePrior, SharedPrior
from service.robot import Robot

Array = NDArray[np.float64]

NOISE_GUESS = 0.002  # of the rated effort: start value only, the noise is then estimated


@dataclass(frozen=True, slots=True)
class TorqueGain:
    """Effort as the drive tells it over true effort, of one axis. A wrong torque constant scales every inertia."""

    gain: float
    std: float


def uncalibrated(robot: Robot) -> TorqueGain:
    """The gain of an axis that no test mass calibrated."""
    return TorqueGain(1.0, robot.prior.effort_gain)


def _typical(robot: Robot, number: int, reference: Array, spectra: list[Spectrum]) -> float:
    """The size of an axis' inertia: the model's; as measured if the rotor, which may outweigh all links, is unknown."""
    if robot.axes[number].reflected_motor_inertia:
        return float(np.median(reference))
    first = [int(np.argmax(spectrum.line)) for spectrum in spectra]
    response = [abs((s.effort[k] / s.velocity[k]).imag) / s.frequency[k] for s, k in zip(spectra, first, strict=True)]
    return float(np.median(response)) / (2 * np.pi)


def shared_prior(robot: Robot, number: int, reference: Array, spectra: list[Spectrum]) -> SharedPrior:
    """The data sheet's drive train. What it does not know (null, or zero) gets a spread wide enough not to matter.

    `reference` (m,): the model's inertias in the axis' poses.
    """
    axis, prior = robot.axes[number], robot.prior
    typical = _typical(robot, number, reference, spectra)
    motor = axis.reflected_motor_inertia
    motor_mean, motor_sigma = (motor, prior.motor_inertia * motor) if motor else (0.5 * typical, 0.5 * typical)
    friction = axis.viscous_friction
    # a corner frequency of 1 Hz where nothing is known; half of it on either side of the spring
    total, spread = (friction, prior.viscous_friction) if friction else (2 * np.pi * typical, 1.0)
    half = total / 2
    half_sigma = max(2 * spread, 1.0) * half
    softest = 1 / (typical * (2 * np.pi * 3.0) ** 2)  # locked rotor at 3 Hz
    return SharedPrior(
        mean=np.array([motor_mean, half, half, 0.0, 1e-3]),
        covariance=np.diag(np.square([motor_sigma, half_sigma, half_sigma, softest, 2e-3])),
    )


def pose_prior(robot: Robot, number: int, reference: float, gravity: Array) -> PosePrior:
    """The model's axis inertia and `gravity` (2,) torque and stiffness in a pose, and how far they may be off."""
    motor = robot.axes[number].reflected_motor_inertia or 0.0
    load = max(reference - motor, 0.1 * reference)
    # torque and stiffness are two components of one vector: either may be off by the error of its length
    spread = robot.prior.gravity * float(np.hypot(*gravity)) + 1e-3 * robot.axes[number].rated_effort
    return PosePrior(
        mean=np.array([load, gravity[1], gravity[0]]),
        sigma=np.array([2 * robot.prior.inertia * reference, spread, spread]),
    )
