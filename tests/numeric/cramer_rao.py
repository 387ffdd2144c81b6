r"""Is the estimate as good as the data allow, and does it know how good it is? Monte Carlo in white torque noise.

The plant of max100-full (springs, gravity, cogging, dry friction) moves once without noise. Each run draws the motor
inertia from the prior that the fit is told: with the same motion a motor heavier by D takes  D DFT[dv/dt]  more effort.
White noise of a sample becomes independent Gaussian parts of variance s^2 / (2 N) in every bin, which are added there:
the statistics are exact.

The bound is computed apart from the fit: the load's differential equation solved in the time domain by
`scipy.signal.lsim` behind the recorded motor motion, derivatives by difference quotients, then the DFT of each over the
window. It takes the bins that the method takes, up to 3 Hz above the last line. (Ripple moves the arm near its
resonance, too, and there J_l shows several times as well, if one believes that a robot is two masses and a linear
spring at its resonance. The method does not.) Unknown: Jm, mu_m, mu_l, k, d of the axis; J_l, k_g, G0, the load's state
at the start and every ripple of each sweep. Priors: those the fit is told (van Trees' form of the bound).
"""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.signal import lsim
from scipy.stats import t as student

from service.identification.axis.axis_estimate import identify_axis
from service.identification.axis.known_effects import KnownAxis
from service.identification.axis.nominal_priors import pose_prior, shared_prior, uncalibrated
from service.identification.estimates.estimate import moving_chain
from service.identification.model import axis_rows, gravity_terms, inertial_parameters
from service.identification.spectra.frequency_response import Spectrum, window
from service.model import Robot, Sweep
from simulator import Measurement
from tests.numeric.campaign import SimulatedCampaign, measure_at, scenario_named

NOISE = 0.002  # of the rated effort, each sample


def bound(campaign: SimulatedCampaign, joint: str, noise: float) -> np.ndarray:
    """Cramer-Rao bound (n,) of the standard deviation of each sweep's J, kg m^2, as the header says."""
    robot, scenario = campaign.robot, campaign.scenario
    number, train = robot.index(joint), scenario.driven(joint).train
    motor = train.motor_inertia * robot.axes[number].gear_ratio ** 2
    spring = train.spring
    assert spring is not None
    shared = np.array(
        [motor, train.motor_friction.viscous, train.load_friction.viscous, spring.stiffness, spring.damping]
    )
    sweeps = [sweep for sweep in campaign.sweeps if sweep.spec.axis == joint]
    truth = campaign.truth(joint)
    reference, gravity = _nominal(robot, number, sweeps)
    spectra = [one for one in campaign.spectra if one.spec.axis == joint]
    # the prior is on compliance c = 1/k and h = d/k: [dc, dh] = [-1/k^2, 0; -d/k^2, 1/k] [dk, dd]
    told = shared_prior(robot, number, reference, spectra)
    jacobian = np.eye(5)
    jacobian[3:, 3:] = [
        [-(spring.stiffness**-2.0), 0.0],
        [-spring.damping * spring.stiffness**-2.0, 1 / spring.stiffness],
    ]
    information = jacobian.T @ np.linalg.inv(told.covariance) @ jacobian
    gains: list[np.ndarray] = []
    own_variance: list[float] = []
    for sweep, spectrum, inertia, model, terms in zip(sweeps, spectra, truth, reference, gravity, strict=True):
        by_shared, by_own = _derivatives(robot, number, sweep, shared, float(inertia) - motor)
        a, b = (_in_band(part, spectrum) / (noise / np.sqrt(2 * len(part))) for part in (by_shared, by_own))
        prior = np.zeros(b.shape[1])
        prior[:3] = pose_prior(robot, number, float(model), terms).sigma ** -2.0
        own = _inverse(b.T @ b + np.diag(prior))
        gain = own @ b.T @ a
        information = information + a.T @ a - a.T @ b @ gain
        gains.append(gain[0])
        own_variance.append(float(own[0, 0]))
    covariance = _inverse(information)
    by_train = -np.array(gains)
    by_train[:, 0] += 1
    return np.sqrt(np.array(own_variance) + np.einsum("ni,ij,nj->n", by_train, covariance, by_train))


def _in_band(derivatives: np.ndarray, spectrum: Spectrum) -> np.ndarray:
    """Real and imaginary parts (2 b, p) of the DFT of derivatives (N, p) at the spectrum's bins."""
    count = len(derivatives)
    bins = np.round(spectrum.frequency * count / spectrum.spec.sample_rate).astype(int)
    transform = np.fft.rfft(derivatives, axis=0)[bins] / count
    return np.concatenate([transform.real, transform.imag])


def _nominal(robot: Robot, number: int, sweeps: list[Sweep]) -> tuple[np.ndarray, np.ndarray]:
    """The nominal model's inertias (n,) and gravity terms (n, 2) in the poses of an axis' sweeps."""
    poses = np.array([sweep.spec.pose for sweep in sweeps])
    parameters = inertial_parameters(robot)
    reference = axis_rows(robot.chain, number, poses) @ parameters
    return reference, gravity_terms(robot.chain, parameters, robot.gravity, number, poses)


def _derivatives(
    robot: Robot, number: int, sweep: Sweep, shared: np.ndarray, load_inertia: float
) -> tuple[np.ndarray, np.ndarray]:
    """Of the effort (N,) by [Jm, mu_m, mu_l, k, d] (N, 5) and by [J_l, k_g, G0, state (2), ripple] (N, p)."""
    first, count = window(sweep.spec, sweep.recording.time)
    part, axis = slice(first, first + count), robot.axes[number]
    time_ = sweep.recording.time[:count]
    way, velocity = sweep.recording.position[part] - sweep.spec.pose[number], sweep.recording.velocity[part]
    acceleration = np.gradient(sweep.recording.velocity, sweep.recording.time)[part]
    system = _load(load_inertia, float(shared[2]), float(shared[3]), float(shared[4]), 0.0)
    moved = [(np.stack([way, velocity, np.zeros(count)], axis=1), np.zeros(2))]
    moved += [(np.zeros((count, 3)), state) for state in np.eye(2)]
    moved += [(np.outer(torque, [0.0, 0.0, 1.0]), np.zeros(2)) for torque in (np.ones(count), way)]
    solved = [lsim(system, inputs, time_, X0=state) for inputs, state in moved]
    # how the load really moved within the window: its state at the start, constant friction, gravity along the way
    assert sweep.recording.load_velocity is not None
    speeds = np.stack([states[:, 1] for _, _, states in solved], -1)
    free = np.linalg.lstsq(speeds[:, 1:], sweep.recording.load_velocity[part] - speeds[:, 0], rcond=None)[0]
    torque = free[2] + free[3] * way

    def effort(values: np.ndarray) -> np.ndarray:
        motor, motor_friction, load_friction, stiffness, damping, load, k_g, g_0 = values
        gravity = g_0 * np.cos(way) + k_g * (np.sin(way) - way) + torque
        inputs = np.stack([way, velocity, gravity], axis=1)
        _, spring, _ = lsim(_load(load, load_friction, stiffness, damping, k_g), inputs, time_, X0=free[:2])
        return motor * acceleration + motor_friction * velocity + spring

    values = np.concatenate([shared, [load_inertia, 0.0, 0.0]])
    # the effort is linear in all of these but J_l, mu_l, k, d: any step does for k_g and G0
    steps = np.concatenate([1e-3 * shared, [1e-3 * load_inertia, 1.0, 1.0]])
    columns = []
    for k, step in enumerate(steps):
        up, down = values.copy(), values.copy()
        up[k] += step
        down[k] -= step
        columns.append((effort(up) - effort(down)) / (2 * step))
    states = [spring for _, spring, _ in solved[1:3]]
    angles = [
        order * axis.gear_ratio * (way + sweep.spec.pose[number])
        for order in sorted({*axis.cogging_orders, *axis.transmission_orders})
    ]
    ripple = [wave(angle) for angle in angles for wave in (np.cos, np.sin)]
    return np.stack(columns[:5], -1), np.stack([*columns[5:], *states, *ripple], -1)


def _load(load: float, friction: float, stiffness: float, damping: float, k_g: float) -> tuple[Any, ...]:
    """Way and speed of the load behind motor way, motor speed and a torque against it; output: the spring's torque."""
    return (
        [[0.0, 1.0], [-(stiffness + k_g) / load, -(damping + friction) / load]],
        [[0.0, 0.0, 0.0], [stiffness / load, damping / load, -1 / load]],
        [[-stiffness, -damping]],
        [[stiffness, damping, 0.0]],
    )


def _inverse(matrix: np.ndarray) -> np.ndarray:
    scale = np.sqrt(np.diag(matrix))
    return np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale)


def _acceleration(sweep: Sweep, spectrum: Spectrum) -> np.ndarray:
    """DFT (b,) of dv/dt over the window: by parts, the ends between two samples."""
    first, count = window(sweep.spec, sweep.recording.time)
    velocity = sweep.recording.velocity
    start, end = (
        (9 * (velocity[k - 1] + velocity[k]) - velocity[k - 2] - velocity[k + 1]) / 16 for k in (first, first + count)
    )
    omega = 2 * np.pi * spectrum.frequency
    # the window begins half a sample before its first one, so the ends turn by half a sample
    turn = np.exp(0.5j * omega / sweep.spec.sample_rate)
    return 1j * omega * spectrum.velocity + turn * (end - start) / (count / sweep.spec.sample_rate)


def simulate(joint: str, poses: np.ndarray, runs: int, seed: int) -> dict[str, float]:
    """Figures of one axis: `runs` estimates of its inertia in `poses` (n, 6)."""
    still = scenario_named("max100-full").model_copy(update={"measurement": Measurement()})
    campaign = measure_at(still, seed, poses, direct_encoder=True, axes=(joint,))
    robot, rng = campaign.robot, np.random.default_rng(seed)
    number = robot.index(joint)
    chain, unlocked = moving_chain(robot, [0, 1, 2], poses)
    nominal = inertial_parameters(robot, chain, unlocked)
    spectra = [replace(one, load_velocity=None) for one in campaign.spectra]  # the fit sees the motor encoder alone
    acceleration = [_acceleration(*pair) for pair in zip(campaign.sweeps, spectra, strict=True)]
    noise = NOISE * robot.axes[number].rated_effort
    limit = bound(campaign, joint, noise)
    told = robot.axes[number].reflected_motor_inertia
    real = campaign.scenario.driven(joint).train.motor_inertia * robot.axes[number].gear_ratio ** 2
    assert told is not None
    truth = campaign.truth(joint)
    error, std, freedom = np.empty((runs, len(poses))), np.empty((runs, len(poses))), np.empty(runs)
    for run in range(runs):
        heavier = rng.normal(told, robot.prior.motor_inertia * told) - real
        measured = [
            replace(one, effort=one.effort + heavier * extra + _noise(rng, one, noise))
            for one, extra in zip(spectra, acceleration, strict=True)
        ]
        axis = identify_axis(robot, number, chain, unlocked, nominal, measured, None, uncalibrated(robot), KnownAxis())
        error[run] = axis.values - truth - heavier
        std[run] = np.sqrt(np.diag(axis.covariance))
        freedom[run] = axis.fit.freedom if axis.fit is not None else np.nan
    inside = np.abs(error) <= np.asarray(student.isf(0.025, freedom))[:, None] * std
    spread = np.sqrt(np.mean(error**2, axis=0))
    return {
        "std_over_bound": float(np.sqrt(np.mean((spread / limit) ** 2))),
        "stated_over_bound": float(np.sqrt(np.mean((std / limit) ** 2))),
        "coverage_percent": 100 * float(inside.mean()),
    }


def _noise(rng: np.random.Generator, spectrum: Spectrum, noise: float) -> np.ndarray:
    parts = rng.normal(0.0, noise / np.sqrt(2 * spectrum.samples), (2, len(spectrum.frequency)))
    return parts[0] + 1j * parts[1]
