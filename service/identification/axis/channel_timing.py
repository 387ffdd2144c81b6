r"""Delay and smoothing of a drive's channels, measured on sweeps whose lines reach well above the free resonance.

A channel has the delay tau and a first-order low-pass T. With S = tau + T and q = T^2,

    L = e^{-s tau} / (1 + s T) = e^{-s S} e^{s T} / (1 + s T),    log L = -s S + q s^2 / 2 + O(T^3),   s = i omega.

S determines the phase of slow lines and the shift of an inertia; q only affects the amplitude at high lines, and
is the natural parameter because L is regular in it at 0. If q is not larger than its noise, or than that of a channel
that is the mean over its sample (q = Ts^2/12), delay and smoothing cannot be separated: then only S is known,
which is sufficient at lines far below 1/T.

Velocity relative to the encoder's position P: V = g L_v s P at the lines; P is first made periodic by removing the
ramp.

Effort relative to motion, with the drive train fitted jointly (all symbols as in `joint_fit`):

    DFT[effort] = L_e (Z Omega + F (G0 R0 + k_g R1 + t0 + s t1) + ripple and dry friction) + b0 + s b1 + noise,
    Omega = V / L_v;

b0 and b1 describe the effect of a lag on a window whose ends differ (gravity changes along the path), like t0 and t1.
That holds for a lag below a sample: the effort is first moved by as many whole samples as a first fit finds.
Below the resonance a delay acts like friction and elasticity like inertia; well above it the motor moves alone, Z is
nearly s Jm, and any change of its phase is L_e. Jm has the data sheet's prior and absorbs a wrong torque gain.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from service import BadInput
from service.identification.axis.drive_train import OWN, SHARED, TwoMassTrain, effort_residual
from service.identification.axis.joint_fit import FitLimits, complete_prior, real_parts
from service.identification.axis.nominal_priors import NOISE_GUESS, PosePrior, SharedPrior, pose_prior, shared_prior
from service.identification.model import (
    SearchResult,
    axis_rows,
    converged,
    finite,
    gravity_terms,
    inertial_parameters,
    scaled_inverse,
)
from service.identification.spectra.frequency_response import Spectrum, spectrum, window
from service.model import Array, Complex, Robot, Sweep

START_SQUARE = 0.5e-3**2  # s^2, q


@dataclass(frozen=True, slots=True)
class Lag:
    """Delay of one channel relative to the position, s. `total` = delay + smoothing, also known if the two are not.

    If they cannot be separated, `delay` is the total and `smoothing` is 0.
    """

    delay: float
    delay_std: float
    smoothing: float
    smoothing_std: float
    total: float
    total_std: float
    apart: bool


@dataclass(frozen=True, slots=True)
class ChannelLags:
    """Result for one axis; `train`: drive train of the same fit, `resonance`: its free resonance, Hz."""

    effort: Lag
    velocity: Lag
    train: TwoMassTrain
    resonance: float


def channel_lags(robot: Robot, joint: str, sweeps: Sequence[Sweep]) -> ChannelLags:
    """Lags of one axis from its periodic sweeps.

    BadInput where their lines do not reach above the free resonance, where a spectrum is not finite, and where a fit
    does not converge.
    """
    own = [sweep for sweep in sweeps if sweep.spec.axis == joint and sweep.spec.periodic]
    if not own:
        raise BadInput(joint, "has no sweep with sines")
    spectra = [_of_motor(robot, sweep) for sweep in own]
    for one in spectra:
        finite(np.stack([one.effort, one.velocity]), f"sweep {one.spec.id} of {joint}", "its spectrum")
    cycle = 1 / min(sweep.spec.sample_rate for sweep in own)
    positions = [_position(sweep, one) for sweep, one in zip(own, spectra, strict=True)]
    velocity = _velocity_lag(spectra, positions, cycle)
    spectra = [replace(one, velocity=one.velocity / _response(velocity, one)) for one in spectra]
    effort, train, load_inertia = _effort_lag(robot, joint, spectra, cycle)
    whole = round(effort.total / cycle)
    if whole:
        moved = [_of_motor(robot, _earlier(sweep, whole)) for sweep in own]
        spectra = [replace(one, velocity=late.velocity) for one, late in zip(moved, spectra, strict=True)]
        effort, train, load_inertia = _effort_lag(robot, joint, spectra, cycle, whole * cycle)
    resonance = float(train.locked_rotor_frequency(load_inertia) * np.sqrt(1 + load_inertia / train.motor_inertia))
    highest = max(float(one.frequency[one.line].max()) for one in spectra)
    if np.isfinite(resonance) and highest <= resonance:
        raise BadInput(
            joint,
            f"the highest line of {highest:g} Hz is not above the free resonance at {resonance:.3g} "
            "Hz: the delay cannot be identified",
        )
    return ChannelLags(effort, velocity, train, resonance)


def _of_motor(robot: Robot, sweep: Sweep) -> Spectrum:
    """The spectrum without a direct encoder, whose delay would be another unknown."""
    return replace(spectrum(robot, sweep), load_velocity=None)


def _earlier(sweep: Sweep, samples: int) -> Sweep:
    """The sweep with its effort shifted earlier by `samples`; the wrapped samples are outside the window."""
    return replace(sweep, recording=replace(sweep.recording, effort=np.roll(sweep.recording.effort, -samples)))


def laplace(frequency: Array) -> Complex:
    """s = i omega (b,) at `frequency` (b,), Hz."""
    return np.multiply(2j * np.pi, frequency, dtype=np.complex128)


def lag_response(s: Complex, total: float, square: float) -> Complex:
    """L (b,) of the header for S and q; for q < 0, which only noise causes, its continuation."""
    if square < 0:
        return np.exp(-s * total + square * s**2 / 2)
    smoothing = np.sqrt(square)
    return np.exp(-s * (total - smoothing)) / (1 + s * smoothing)


def _by_square(s: Complex, square: float) -> Complex:
    """d log L / d q."""
    return s**2 / 2 / (1 + s * np.sqrt(max(square, 0.0)))


def _response(lag: Lag, one: Spectrum) -> Complex:
    return lag_response(laplace(one.frequency), lag.delay + lag.smoothing, lag.smoothing**2)


def _lag(total: float, square: float, covariance: Array, cycle: float) -> Lag:
    """`covariance` (2, 2) of S and q."""
    # one sigma of S and q: of time stamps, and of an instant or a mean over the sample (two sigma)
    covariance = covariance + np.diag([((1 / 500) * cycle) ** 2, ((1 / 24) * cycle**2) ** 2])
    total_std, square_std = (float(np.sqrt(value)) for value in np.diag(covariance))
    if not square > 3.0 * square_std:  # three sigma from 0
        # the error of q is the error of T
        return Lag(total, total_std, 0.0, float(np.sqrt(max(square, 0.0) + square_std)), total, total_std, apart=False)
    smoothing = float(np.sqrt(square))
    by = np.array([1.0, -0.5 / smoothing])  # delay = S - sqrt(q)
    delay_std = float(np.sqrt(by @ covariance @ by))
    return Lag(total - smoothing, delay_std, smoothing, square_std / (2 * smoothing), total, total_std, apart=True)


def _position(sweep: Sweep, one: Spectrum) -> Complex:
    """DFT (b,) of the position in the spectrum's bins, without the ramp over the window."""
    first, count = window(sweep.spec, sweep.recording.time)
    record = sweep.recording.position
    if first + count >= len(record):
        raise BadInput(f"sweep {sweep.spec.id}", "has no sample after the measured window")
    way = record[first : first + count] - record[first]
    ramp = (record[first + count] - record[first]) * np.arange(count) / count
    bins = np.round(one.frequency * count / sweep.spec.sample_rate).astype(int)
    return np.asarray(np.fft.rfft(way - ramp)[bins] / count, dtype=np.complex128)


def _velocity_lag(spectra: Sequence[Spectrum], positions: Sequence[Complex], cycle: float) -> Lag:
    """From the lines of all sweeps; noise from the bins between them."""
    noise = [
        float(np.std((one.velocity - laplace(one.frequency) * position)[~one.line]))
        for one, position in zip(spectra, positions, strict=True)
    ]
    s = laplace(np.concatenate([one.frequency[one.line] for one in spectra]))
    motion = s * np.concatenate([position[one.line] for one, position in zip(spectra, positions, strict=True)])
    velocity = np.concatenate([one.velocity[one.line] for one in spectra])
    sigma = np.concatenate([np.full(int(one.line.sum()), own) for one, own in zip(spectra, noise, strict=True)])
    # a simulation may have no noise
    sigma = np.maximum(sigma / np.sqrt(2), 1e-9 * np.abs(velocity).max())

    def residual(values: Array) -> Array:
        gain, total, square = values
        return real_parts((velocity - gain * lag_response(s, total, square) * motion) / sigma)

    def jacobian(values: Array) -> Array:
        gain, total, square = values
        model = lag_response(s, total, square) * motion
        columns = (model, -s * gain * model, _by_square(s, square) * gain * model)
        return np.stack([-real_parts(column / sigma) for column in columns], -1)

    fit = least_squares(residual, [1.0, 0.0, START_SQUARE], jacobian, method="lm", x_scale="jac")
    converged(fit, spectra[0].spec.axis, "the velocity's delay")
    freedom = max(len(fit.fun) - len(fit.x), 1)
    slope = jacobian(fit.x)
    covariance = scaled_inverse(slope.T @ slope) * max(2 * float(fit.cost) / freedom, 1.0)
    return _lag(float(fit.x[1]), float(fit.x[2]), covariance[1:, 1:], cycle)


def _effort_lag(
    robot: Robot, joint: str, spectra: list[Spectrum], cycle: float, taken: float = 0.0
) -> tuple[Lag, TwoMassTrain, float]:
    """Delay, drive train, and the median load inertia, kg m^2 (kg); `taken` s are already removed from the effort."""
    number = robot.index(joint)
    poses = np.array([one.spec.pose for one in spectra])
    nominal = inertial_parameters(robot)
    reference = axis_rows(robot.chain, number, poses) @ nominal
    gravity = gravity_terms(robot.chain, nominal, robot.gravity, number, poses)
    priors = [
        _with_ends(complete_prior(one, pose_prior(robot, number, inertia, terms)))
        for one, inertia, terms in zip(spectra, reference, gravity, strict=True)
    ]
    problem = _LagProblem(spectra, shared_prior(robot, number, reference, spectra), priors)
    noise = np.array([NOISE_GUESS * robot.axes[number].rated_effort / np.sqrt(2 * one.samples) for one in spectra])
    # a few evaluations tell which start leads to the lowest minimum
    starts = [problem.search(problem.start(frequency), noise, 12).x for frequency in FitLimits.starts]
    values = min(starts, key=lambda candidate: float(np.sum(problem.rows(candidate, noise)[0] ** 2)))
    for _ in range(3):  # rounds of fitting and estimating the noise
        found = problem.search(values, noise, 100)
        converged(found, joint, "the effort's delay")
        values = np.asarray(found.x, dtype=float)
        noise = problem.noise(values)
    jacobian = problem.rows(values, noise)[1]
    covariance = scaled_inverse(jacobian.T @ jacobian)
    part = slice(SHARED, SHARED + 2)
    total, square = float(values[SHARED]), float(values[SHARED + 1])
    load_inertia = float(np.median([own[0] for own in problem.own(values)]))
    return _lag(total + taken, square, covariance[part, part], cycle), TwoMassTrain.of(values), load_inertia


def _with_ends(prior: PosePrior) -> PosePrior:
    """b0 and b1 appended, with the same wide prior as t0 and t1."""
    return PosePrior(np.append(prior.mean, [0.0, 0.0]), np.append(prior.sigma, prior.sigma[OWN - 2 : OWN]))


@dataclass(frozen=True)
class _LagProblem:
    """Least squares over [shared (5), S, q, own parameters of every sweep], rows in standard deviations."""

    spectra: Sequence[Spectrum]
    shared: SharedPrior
    poses: Sequence[PosePrior]

    def start(self, locked_rotor: float) -> Array:
        shared = self.shared.mean.copy()
        typical = float(np.median([prior.mean[0] for prior in self.poses]))
        shared[3] = 0.0 if np.isinf(locked_rotor) else 1 / (typical * (2 * np.pi * locked_rotor) ** 2)
        return np.concatenate([shared, [0.0, START_SQUARE], *(prior.mean for prior in self.poses)])

    def own(self, values: Array) -> list[Array]:
        """The own parameters sweep by sweep."""
        edges = np.cumsum([len(prior.mean) for prior in self.poses])
        return np.split(values[SHARED + 2 :], edges[:-1])

    def rows(self, values: Array, noise: Array) -> tuple[Array, Array]:
        """Residual (r,) and its derivatives (r, parameters)."""
        shared, (total, square) = values[:SHARED], values[SHARED : SHARED + 2]
        mean = np.concatenate([self.shared.mean, [0.0, 0.0], *(prior.mean for prior in self.poses)])
        sigma = np.concatenate([self.shared.sigma, [np.inf, np.inf], *(prior.sigma for prior in self.poses)])
        residuals, jacobians = [(values - mean) / sigma], [np.diag(1 / sigma)]
        column = SHARED + 2
        for one, own, deviation in zip(self.spectra, self.own(values), noise, strict=True):
            rest, by_shared, by_own = effort_residual(one, shared, own[:-2])
            s = laplace(one.frequency)
            lag = lag_response(s, total, square)
            model = lag * (one.effort - rest)
            ends = np.stack([np.ones_like(s), s], -1)
            by_lag = np.stack([-s * model, _by_square(s, square) * model], -1)
            block = np.zeros((2 * len(s), len(values)))
            block[:, : SHARED + 2] = real_parts(np.hstack([lag[:, None] * by_shared, by_lag]))
            block[:, column : column + len(own)] = real_parts(np.hstack([lag[:, None] * by_own, ends]))
            residuals.append(real_parts(one.effort - model - ends @ own[-2:]) / deviation)
            jacobians.append(-block / deviation)
            column += len(own)
        return np.concatenate(residuals), np.concatenate(jacobians)

    def search(self, values: Array, noise: Array, evaluations: int) -> SearchResult:
        """SciPy's result from `values` on."""
        return least_squares(
            lambda x: self.rows(x, noise)[0],
            values,
            lambda x: self.rows(x, noise)[1],
            method="lm",
            x_scale="jac",
            max_nfev=evaluations,
        )

    def noise(self, values: Array) -> Array:
        """Standard deviation (n,) of real and imaginary part of an effort bin, pooled over all sweeps."""
        unit = np.array([1 / np.sqrt(one.samples) for one in self.spectra])
        left = self.rows(values, unit)[0][len(values) :]
        return unit * np.sqrt(float(left @ left) / max(len(left) - len(values), 1))
