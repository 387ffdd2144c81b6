r"""All sweeps of one axis fitted at once: the drive train is shared, the load inertia belongs to the pose.

Bin by bin (see `frequency_response` and `axis_inertia` for the symbols), for sweep p,

    DFT[effort] = Z Omega + F (G0 R0 + k_g R1 + t0 + s t1) + sum of ripple and dry friction + noise
    R0 = DFT[cos d],   R1 = DFT[sin d] - Omega / s

G0 and k_g are gravity's torque and stiffness at the start pose; Z already carries the linear, periodic part of k_g, R1
what is left of it (the way along the offset leaks onto every line). t0, t1 are the swing-out of the load: over a window
that does not start at rest a rational system leaves a polynomial over the same denominator (Pintelon and Schoukens
2012, sec. 6.3). Shared: Jm, mu_m, mu_l, c, h. Own to each sweep: J_l, k_g, G0, t0, t1, and one factor
for each ripple and for the sign of a velocity that reverses.

Gauss-Newton with Levenberg's damping on the real and imaginary parts, every prior of the data sheet a row more. The own
parameters are eliminated sweep by sweep (Schur complement), so the cost grows linearly with the number of sweeps. The
noise variance is pooled over the sweeps of one sample rate, from residuals with the degrees of freedom used up removed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.axis_inertia import DriveTrain, impedance
from service.identification.frequency_response import Complex, Spectrum

Array = NDArray[np.float64]

SHARED = 5  # parameters of DriveTrain
OWN = 5  # J_l, k_g, G0, t0, t1; the factors of the direct terms follow
FREE = 10.0  # times the largest effort bin: one sigma of what nothing is known of
ITERATIONS = 60
ROUNDS = 4  # of fitting and estimating the noise
STARTS = (np.inf, 25.0, 16.0, 11.0, 8.0, 6.0)  # Hz, locked-rotor frequencies tried as start
FEW = 4.0  # degrees of freedom left, below which residuals do not show the noise: the guess stands
NOISE_FLOOR = 1e-7  # of the largest effort at a line: rounding, where a simulation has no noise


@dataclass(frozen=True)
class SharedPrior:
    """Mean (5,) and one sigma (5,) of the drive train, in the order of `DriveTrain.as_array`."""

    mean: Array
    sigma: Array


@dataclass(frozen=True)
class PosePrior:
    """What the nominal model says of one sweep's pose: mean and one sigma of [J_l, k_g, G0]."""

    mean: Array
    sigma: Array


@dataclass(frozen=True)
class JointFit:
    """Result for n sweeps of one axis, in the order given.

    `inertia` (n,) = Jm + J_l, `covariance` (n, n) of it; `gravity` (n, 2) the fitted k_g and G0; `noise` (n,) the
    standard deviation of real and imaginary part of an effort bin; `chi_squared` (n,) each sweep's share of it, per
    degree of freedom, with the noise pooled.
    """

    train: DriveTrain
    train_std: Array
    load_inertia: Array
    gravity: Array
    inertia: Array
    covariance: Array
    noise: Array
    chi_squared: Array


@dataclass(frozen=True)
class _Point:
    shared: Array  # (5,)
    own: tuple[Array, ...]  # n of (OWN + direct terms,)


@dataclass(frozen=True)
class _Normal:
    """Normal equations of one sweep, bordered: own block, coupling, shared block and the gradient of each."""

    own: Array
    coupling: Array
    shared: Array
    own_gradient: Array
    shared_gradient: Array


def fit_axis(
    spectra: Sequence[Spectrum], shared_prior: SharedPrior, pose_priors: Sequence[PosePrior], noise_guess: float
) -> JointFit:
    """Fit all periodic sweeps of one axis; `noise_guess` is the effort noise of one sample, N m (N)."""
    noise = np.array([noise_guess / np.sqrt(2 * spectrum.samples) for spectrum in spectra])
    priors = _Priors(shared_prior, tuple(map(complete_prior, spectra, pose_priors)))
    point = min(
        (_minimise(spectra, priors, noise, _start(priors, frequency), 8) for frequency in STARTS),
        key=lambda candidate: _cost(spectra, priors, noise, candidate),
    )
    chi_squared = np.ones(len(spectra))
    for _ in range(ROUNDS):
        point = _minimise(spectra, priors, noise, point, ITERATIONS)
        noise, chi_squared = _pooled_noise(spectra, point, noise_guess)
    return _result(spectra, priors, noise, point, chi_squared)


@dataclass(frozen=True)
class _Priors:
    shared: SharedPrior
    poses: tuple[PosePrior, ...]  # of all own parameters


def complete_prior(spectrum: Spectrum, prior: PosePrior) -> PosePrior:
    """The prior with a wide one for the own parameters that no model knows: it only matters where bins are few."""
    wide = FREE * float(np.abs(spectrum.effort).max())
    slope = wide / (2 * np.pi * float(spectrum.frequency[-1]))
    unknown = np.array([wide, slope, *(wide for _ in _direct(spectrum))])
    return PosePrior(np.concatenate([prior.mean, np.zeros_like(unknown)]), np.concatenate([prior.sigma, unknown]))


def _direct(spectrum: Spectrum) -> Complex:
    """Regressors of what acts on the motor itself, (r, b)."""
    return np.concatenate([spectrum.named("ripple"), spectrum.named("coulomb")])


def _start(priors: _Priors, locked_rotor: float) -> _Point:
    shared = priors.shared.mean.copy()
    typical = float(np.median([prior.mean[0] for prior in priors.poses]))
    shared[3] = 0.0 if np.isinf(locked_rotor) else 1 / (typical * (2 * np.pi * locked_rotor) ** 2)
    return _Point(shared, tuple(prior.mean for prior in priors.poses))


def effort_residual(spectrum: Spectrum, shared: Array, own: Array) -> tuple[Complex, Complex, Complex]:
    """Effort not explained (b,); derivatives of what is by the shared (b, 5) and own (b, OWN + r) parameters."""
    motor_inertia, motor_friction, load_friction, compliance, damping_time = shared
    train = DriveTrain(motor_inertia, motor_friction, load_friction, compliance, damping_time)
    z = impedance(spectrum.frequency, train, own[0], own[1])
    s, velocity = z.s, spectrum.velocity
    gravity_torque, gravity_rest = _gravity(spectrum, s)
    on_load = own[2] * gravity_torque + own[1] * gravity_rest + own[3] + s * own[4]
    direct = _direct(spectrum)
    model = z.total * velocity + z.through * on_load + own[OWN:] @ direct
    by_load = z.by_load(velocity, on_load)
    by_spring = z.by_spring(velocity, on_load)
    damped = 1 + s * damping_time
    by_shared = np.stack(
        [s * velocity, velocity, by_load, by_spring * s / damped, -by_spring * s**2 * compliance / damped**2], -1
    )
    by_own = np.stack(
        [
            s * by_load,
            by_load / s + z.through * gravity_rest,
            z.through * gravity_torque,
            z.through,
            s * z.through,
            *direct,
        ],
        -1,
    )
    return spectrum.effort - model, by_shared, by_own


def _gravity(spectrum: Spectrum, s: Complex) -> tuple[Complex, Complex]:
    torque, stiffness = spectrum.named("gravity_torque"), spectrum.named("gravity_stiffness")
    if not len(torque):
        return np.zeros_like(s), np.zeros_like(s)
    return torque[0], stiffness[0] - spectrum.velocity / s


def _normal(spectrum: Spectrum, prior: PosePrior, noise: float, shared: Array, own: Array) -> _Normal:
    residual, by_shared, by_own = effort_residual(spectrum, shared, own)
    r, a, b = (real_parts(part) / noise for part in (residual, by_shared, by_own))
    weight = 1 / prior.sigma**2
    pull = weight * (prior.mean - own)
    return _Normal(b.T @ b + np.diag(weight), b.T @ a, a.T @ a, b.T @ r + pull, a.T @ r)


def _cost(spectra: Sequence[Spectrum], priors: _Priors, noise: Array, point: _Point) -> float:
    total = float(np.sum(((point.shared - priors.shared.mean) / priors.shared.sigma) ** 2))
    for spectrum, prior, sigma, own in zip(spectra, priors.poses, noise, point.own, strict=True):
        residual = effort_residual(spectrum, point.shared, own)[0]
        total += float(np.sum(np.abs(residual) ** 2)) / sigma**2
        total += float(np.sum(((own - prior.mean) / prior.sigma) ** 2))
    return total


def _minimise(spectra: Sequence[Spectrum], priors: _Priors, noise: Array, point: _Point, iterations: int) -> _Point:
    damping, cost = 1e-3, _cost(spectra, priors, noise, point)
    for _ in range(iterations):
        normals = [
            _normal(spectrum, prior, sigma, point.shared, own)
            for spectrum, prior, sigma, own in zip(spectra, priors.poses, noise, point.own, strict=True)
        ]
        while True:
            trial = _step(normals, priors, point, damping)
            trial_cost = _cost(spectra, priors, noise, trial)
            if trial_cost <= cost or damping > 1e8:
                break
            damping *= 10
        if trial_cost > cost:
            return point
        gained, point, cost = cost - trial_cost, trial, trial_cost
        damping = max(damping / 10, 1e-12)
        if gained < 1e-9 * (1 + cost):
            return point
    return point


def _step(normals: Sequence[_Normal], priors: _Priors, point: _Point, damping: float) -> _Point:
    weight = 1 / priors.shared.sigma**2
    matrix = np.diag(weight)
    gradient = weight * (priors.shared.mean - point.shared)
    eliminated: list[tuple[Array, Array]] = []
    for normal in normals:
        inverse = scaled_inverse(normal.own + damping * np.diag(np.diag(normal.own)))
        gain = inverse @ normal.coupling
        matrix = matrix + normal.shared - normal.coupling.T @ gain
        gradient = gradient + normal.shared_gradient - gain.T @ normal.own_gradient
        eliminated.append((inverse @ normal.own_gradient, gain))
    shared_step = scaled_inverse(matrix + damping * np.diag(np.diag(matrix))) @ gradient
    own = tuple(values + step - gain @ shared_step for values, (step, gain) in zip(point.own, eliminated, strict=True))
    return _Point(point.shared + shared_step, own)


def _pooled_noise(spectra: Sequence[Spectrum], point: _Point, guess: float) -> tuple[Array, Array]:
    squares = np.array(
        [
            float(np.sum(np.abs(effort_residual(spectrum, point.shared, own)[0]) ** 2)) * spectrum.samples
            for spectrum, own in zip(spectra, point.own, strict=True)
        ]
    )
    # the prior leaves k_g and G0 nearly free, the shared parameters are spread over all sweeps
    freedom = np.array(
        [
            2 * len(spectrum.frequency) - len(own) - SHARED / len(spectra)
            for spectrum, own in zip(spectra, point.own, strict=True)
        ]
    )
    rate = np.array([spectrum.spec.sample_rate for spectrum in spectra])
    variance = np.empty(len(spectra))
    for value in np.unique(rate):
        same = rate == value
        left = float(freedom[same].sum())
        variance[same] = squares[same].sum() / left if left >= FEW else guess**2 / 2
    samples = np.array([spectrum.samples for spectrum in spectra])
    floor = np.array([NOISE_FLOOR * float(np.abs(spectrum.effort).max()) for spectrum in spectra])
    noise = np.maximum(np.sqrt(variance / samples), floor)
    return noise, squares / samples / noise**2 / np.maximum(freedom, 1.0)


def _result(spectra: Sequence[Spectrum], priors: _Priors, noise: Array, point: _Point, chi_squared: Array) -> JointFit:
    matrix = np.diag(1 / priors.shared.sigma**2)
    sensitivity: list[Array] = []
    own_variance: list[float] = []
    for spectrum, prior, sigma, own in zip(spectra, priors.poses, noise, point.own, strict=True):
        normal = _normal(spectrum, prior, sigma, point.shared, own)
        inverse = scaled_inverse(normal.own)
        gain = inverse @ normal.coupling
        matrix = matrix + normal.shared - normal.coupling.T @ gain
        sensitivity.append(-gain[0])  # d J_l / d shared
        own_variance.append(inverse[0, 0])
    shared_covariance = scaled_inverse(matrix)
    by_shared = np.array(sensitivity)
    by_shared[:, 0] += 1  # J = Jm + J_l
    load = np.array([own[0] for own in point.own])
    motor_inertia, motor_friction, load_friction, compliance, damping_time = (float(value) for value in point.shared)
    return JointFit(
        train=DriveTrain(motor_inertia, motor_friction, load_friction, compliance, damping_time),
        train_std=np.sqrt(np.diag(shared_covariance)),
        load_inertia=load,
        gravity=np.array([own[1:3] for own in point.own]),
        inertia=load + motor_inertia,
        covariance=by_shared @ shared_covariance @ by_shared.T + np.diag(own_variance),
        noise=noise,
        chi_squared=chi_squared,
    )


def real_parts(values: Complex) -> Array:
    return np.concatenate([values.real, values.imag])


def scaled_inverse(matrix: Array) -> Array:
    """Inverse of a positive definite matrix, scaled to a unit diagonal first: the units differ by ten decades."""
    scale = np.sqrt(np.diag(matrix))
    scale = np.where(scale > 0, scale, 1.0)
    eigenvalues, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    eigenvalues = np.maximum(eigenvalues, 1e-14 * eigenvalues[-1])
    return (vectors / eigenvalues) @ vectors.T / np.outer(scale, scale)
