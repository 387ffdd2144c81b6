"""Priors before any measurement: the data sheet's drive train, the nominal model, the torque constant.

And values known better from a diagnosis: the spring, a hose, the torque constant (`known_effects`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.identification.axis.known_effects import ELASTICITY, GAIN, HOSE, GearLoad, KnownAxis
from service.identification.design.pose_selection import Assumed
from service.identification.model import counterbalance_terms, link_sizes
from service.identification.spectra.frequency_response import Spectrum
from service.model import Array, Chain, Robot

NOISE_GUESS = 0.002  # of the rated effort: start value only, the noise is then estimated


@dataclass(frozen=True)
class SharedPrior:
    """Mean (5,) and covariance (5, 5) of the drive train, in the order of `DriveTrain.as_array`."""

    mean: Array
    covariance: Array

    @property
    def sigma(self) -> Array:
        """One sigma (5,)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True)
class PosePrior:
    """Nominal model in the pose of one sweep: mean and one sigma of [J_l, k_g, G0]."""

    mean: Array
    sigma: Array


def gear_load(robot: Robot, number: int, pose: Sequence[float], prior: PosePrior) -> GearLoad:
    """The load of a gear before a fit: the nominal model in the pose of a sweep, and the counterbalance there."""
    torque, stiffness = counterbalance_terms(robot, number, np.array(pose))[0].tolist()
    inertia, gravity_stiffness, gravity = prior.mean.tolist()
    return GearLoad(inertia, gravity + torque, gravity_stiffness + stiffness)


@dataclass(frozen=True, slots=True)
class TorqueGain:
    """Effort reported by the drive over true effort, of one axis. A wrong torque constant scales every inertia."""

    gain: float
    std: float


def uncalibrated(robot: Robot) -> TorqueGain:
    """The gain of an axis without calibration by a test mass."""
    return TorqueGain(1.0, robot.prior.effort_gain)


def torque_gain(robot: Robot, known: KnownAxis) -> TorqueGain:
    """The gain of an axis without calibration by a test mass: from its model, else the prior."""
    effect = known.get(GAIN)
    if effect is None:
        return uncalibrated(robot)
    return TorqueGain(1 + effect.values["gain_error"], effect.std["gain_error"])


def with_known_spring(prior: SharedPrior, known: KnownAxis, gain: float) -> SharedPrior:
    """The drive train's prior combined with the spring found by a diagnosis, two independent sources of the same
    values.

    The diagnosis' spring carries `ratio` times the load that the nominal motor inertia leaves: at the true load its
    compliance is compliance / ratio. `gain`: effort reported by the drive over true effort, see `known_effects`.
    """
    effect = known.get(ELASTICITY)
    if effect is None:
        return prior
    scale = (1.0 if known.true_torque else gain) / effect.values.get("ratio", 1.0)
    compliance, damping = scale * effect.values["compliance"], effect.values["damping_time"]
    relative = [effect.std[name] / effect.values[name] for name in ("compliance", "ratio") if name in effect.values]
    noise = np.diag([(compliance * float(np.hypot.reduce(relative))) ** 2, effect.std["damping_time"] ** 2])
    seen = slice(3, 5)
    blend = prior.covariance[:, seen] @ np.linalg.inv(prior.covariance[seen, seen] + noise)
    return SharedPrior(
        mean=prior.mean + blend @ (np.array([compliance, damping]) - prior.mean[seen]),
        covariance=prior.covariance - blend @ prior.covariance[seen, :],
    )


def with_known_hose(prior: PosePrior, known: KnownAxis, gain: float) -> PosePrior:
    """A hose acts like gravity's stiffness: towards its rest position, wherever that is."""
    effect = known.get(HOSE)
    if effect is None:
        return prior
    stiffness = effect.values["stiffness"] / (1.0 if known.true_torque else gain)
    return PosePrior(prior.mean + np.array([0.0, stiffness, 0.0]), prior.sigma)


def _typical(robot: Robot, number: int, reference: Array, spectra: list[Spectrum]) -> float:
    """Typical inertia of an axis: that of the model; the measured one if the rotor, which may dominate, is unknown."""
    if robot.axes[number].reflected_motor_inertia or not spectra:
        return float(np.median(reference))
    first = [int(np.argmax(spectrum.line)) for spectrum in spectra]
    response = [abs((s.effort[k] / s.velocity[k]).imag) / s.frequency[k] for s, k in zip(spectra, first, strict=True)]
    return float(np.median(response)) / (2 * np.pi)


def shared_prior(robot: Robot, number: int, reference: Array, spectra: list[Spectrum]) -> SharedPrior:
    """The data sheet's drive train. Unknown values (null, or zero) get a spread wide enough not to matter.

    `reference` (m,): the model's inertias in the axis' poses.
    """
    unknown_motor = 0.5  # of the axis' inertia: a motor that no data sheet gives, and one sigma of it
    axis, prior = robot.axes[number], robot.prior
    typical = _typical(robot, number, reference, spectra)
    motor = axis.reflected_motor_inertia
    motor_mean, motor_sigma = (
        (motor, prior.motor_inertia * motor) if motor else (unknown_motor * typical, unknown_motor * typical)
    )
    friction = axis.viscous_friction
    # half of it on either side of the spring
    # unknown: a corner mu / (2 pi J) of 1 Hz
    total, spread = (friction, prior.viscous_friction) if friction else (2 * np.pi * 1.0 * typical, 1.0)
    half = total / 2
    half_sigma = max(2 * spread, 1.0) * half
    softest = 1 / (typical * (2 * np.pi * Assumed.softest) ** 2)
    return SharedPrior(
        mean=np.array([motor_mean, half, half, 0.0, 1e-3]),  # s, damping time of the spring
        covariance=np.diag(np.square([motor_sigma, half_sigma, half_sigma, softest, 2e-3])),
    )


def pose_prior(robot: Robot, number: int, reference: float, gravity: Array) -> PosePrior:
    """The model's axis inertia and `gravity` (2,) torque and stiffness in a pose, with their uncertainty."""
    motor = robot.axes[number].reflected_motor_inertia or 0.0
    # at least a tenth, where the motor's data sheet leaves nothing of it
    load = max(reference - motor, 0.1 * reference)
    # torque and stiffness are two components of one vector: each may have the error of its length
    # besides its own error one sigma of 1e-3 of the rated effort: cables, offsets of the base
    spread = robot.prior.gravity * float(np.hypot(*gravity)) + 1e-3 * robot.axes[number].rated_effort
    return PosePrior(
        mean=np.array([load, gravity[1], gravity[0]]),
        sigma=np.array([2 * robot.prior.inertia * reference, spread, spread]),
    )


def link_spread(links: Array, inertia: float) -> Array:
    """Standard deviations (10 n,) of the parameters of links (n, 10) whose inertia is known to `inertia`, relative.

    By the size of a link, mass m and radius of gyration r: m, m r and m r^2 for mass, first and second moments.
    """
    # a link without mass in the model is as uncertain as 1 % of the mean link
    return inertia * link_sizes(links, 0.01 * float(links[:, 0].mean()))


def model_spread(robot: Robot, chain: Chain, unlocked: tuple[int, ...], combination: Array, largest: float) -> Array:
    """Standard deviations (r,) of the base parameters  beta = `combination` (r, 11 n) x  in the nominal model.

    `largest`: inertia of an axis, kg m^2 (kg), for a motor without data sheet.
    """
    motors = [(robot.axes[number].reflected_motor_inertia or 0.0) * robot.prior.motor_inertia for number in unlocked]
    spread = np.concatenate([link_spread(chain.inertial, robot.prior.inertia), [own or largest for own in motors]])
    return np.sqrt(combination**2 @ spread**2)


def base_spread(
    robot: Robot, chain: Chain, unlocked: tuple[int, ...], combination: Array, measured: "MeasuredInertias"
) -> Array:
    """Standard deviations (r,) of the base parameters  beta = `combination` (r, 11 n) x  in the nominal model, after a
    measurement.

    If the model differs from the measurement by more than its prior, the prior is widened accordingly: it must not
    override the data.
    """
    base = model_spread(robot, chain, unlocked, combination, float(np.abs(measured.values).max()))
    variance = measured.rows**2 @ base**2 + measured.variance
    return base * max(1.0, float(np.sqrt(np.mean((measured.values - measured.model) ** 2 / variance))))


@dataclass(frozen=True)
class MeasuredInertias:
    """Axis inertias (m,) with their variance, the model's, and their rows (m, r) in the base parameters."""

    values: Array
    variance: Array
    model: Array
    rows: Array
