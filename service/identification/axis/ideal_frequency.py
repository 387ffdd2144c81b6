r"""Initial analysis of an axis (paper, sections 4.1 and 4.2): drive train, locked rotor, ideal sweep frequency.

The input is the frequency response of the axis in several poses (`noise_response`). Two methods compute the first
locked-rotor frequency f_l, where the motor stands and the load oscillates, and the corner f_c below which friction
dominates:

Fit. The two-mass impedance (`drive_train`) to all poses at once, every line weighted by its variance: Jm, mu_m, mu_l,
c, h are shared, J_l and k_g belong to the pose; data sheet and nominal model are priors. Gauss-Newton by SciPy,
with the weights computed again at the fitted Z, because near f_l the measured Z is a quotient of small numbers. Then

    f_l = 1 / (2 pi sqrt(c J_l)),    f_c = (mu_m + mu_l) / (2 pi (Jm + J_l))

with standard deviations from the covariance of the fit, which is multiplied by chi^2 per degree of freedom if that is
above 1.

Asymptotes, as in the paper's Fig. 1b, each pose by itself: |Z|/omega, an apparent inertia, is level at J up to the
resonance f_l, its maximum (parabola through three lines of its logarithm); friction is the line mu/omega, mu being the
part of Z in phase on the level part and below, and f_c where the two meet, the 3 dB point.

The ideal frequency is sqrt(f_l f_c), rounded to 2, 3, 4 or 5 Hz. If the train is so stiff that f_l is above the last
line, f_l was not observed: then the last line is its lower bound, from which that of the ideal frequency follows.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import optimize

from service import BadInput
from service.identification.axis.drive_train import TwoMassTrain, impedance
from service.identification.axis.joint_fit import SHARED, FitLimits
from service.identification.axis.nominal_priors import PosePrior, SharedPrior
from service.identification.design.excitation import Sines
from service.identification.model import SearchResult, converged, finite, scaled_inverse
from service.identification.spectra.noise_response import FrequencyResponse
from service.model import Array, Complex
from service.model.results.estimate import Figure, Ideal, PoseClass

LEVEL = (0.15, 0.45)  # of f_l: lines used for the level asymptote


@dataclass(frozen=True, slots=True)
class PoseAnalysis:
    """One pose: all joint positions, rad (m); the measured response and the result of both methods."""

    pose: tuple[float, ...]
    response: FrequencyResponse
    load_inertia: float
    fit: Ideal
    asymptotes: Ideal

    @property
    def at_least(self) -> tuple[float, float] | None:
        """Of the fit, `Ideal.at_least`."""
        return self.fit.at_least(float(self.response.frequency[-1]))


@dataclass(frozen=True)
class InitialAnalysis:
    """Result of the initial analysis of one axis.

    `mean` (5,) and `covariance` (5, 5) of the drive train in the order of `DriveTrain.as_array`, including the data
    sheet's prior: this is the prior of the joint fit. `chi_squared` per degree of freedom of the fit.
    """

    mean: Array
    covariance: Array
    chi_squared: float
    poses: tuple[PoseAnalysis, ...]

    @property
    def train(self) -> TwoMassTrain:
        return TwoMassTrain.of(self.mean)

    @property
    def classes(self) -> tuple[PoseClass, ...]:
        """Light and heavy poses, divided at the geometric mean of the extremes; one class if they hardly differ."""
        fits = sorted((pose.fit for pose in self.poses), key=lambda fit: fit.inertia.value)
        low, high = fits[0].inertia.value, fits[-1].inertia.value
        if high <= 1.25 * low:  # they hardly differ
            return (_class("all", np.inf, fits),)
        border = float(np.sqrt(low * high))
        light = [fit for fit in fits if fit.inertia.value <= border]
        return _class("light", border, light), _class("heavy", np.inf, fits[len(light) :])

    def locked_rotor(self, load_inertia: float) -> float:
        """Expected first locked-rotor frequency at a load inertia, Hz; inf for a stiff train."""
        return self.train.locked_rotor_frequency(load_inertia)

    def lines(self, load_inertia: float) -> tuple[float, ...]:
        """Sweep frequencies at a load inertia, Hz: the ideal one of its class, and those allowed by the resonance."""
        inertia = load_inertia + self.train.motor_inertia
        ideal = next(each for each in self.classes if inertia <= each.inertia_up_to).sweep_frequency
        highest = Sines.line_margin * self.locked_rotor(load_inertia)
        return tuple(line for line in Sines.lines if line <= highest or line == ideal)


def _class(name: str, up_to: float, fits: Sequence[Ideal]) -> PoseClass:
    ideal = float(np.exp(np.mean([np.log(max(fit.frequency.value, Sines.lines[0])) for fit in fits])))
    locked_rotor = min(fit.locked_rotor.value for fit in fits)
    return PoseClass(name=name, inertia_up_to=up_to, locked_rotor=locked_rotor, sweep_frequency=nearest_line(ideal))


def nearest_line(frequency: float) -> float:
    """Rounded to 2, 3, 4 or 5 Hz; 5 Hz for the infinite frequency of a stiff train."""
    return min(Sines.lines, key=lambda line: abs(line - min(frequency, Sines.lines[-1])))


def analyse_axis(
    joint: str,
    poses: Sequence[tuple[float, ...]],
    responses: Sequence[FrequencyResponse],
    shared_prior: SharedPrior,
    pose_priors: Sequence[PosePrior],
) -> InitialAnalysis:
    """The analysis of one axis from its responses in n poses; `shared_prior`: the data sheet's drive train.

    BadInput where the responses have fewer numbers than there are to find, one is not finite, or the fit does not
    converge.
    """
    for number, response in enumerate(responses, start=1):
        with np.errstate(divide="ignore", invalid="ignore"):
            weight = 1 / np.sqrt(response.variance(response.impedance))
        finite(response.impedance, joint, f"its frequency response in pose {number}")
        finite(weight, joint, f"the weight of its frequency response in pose {number}")
    problem = _ResponseProblem(tuple(responses), shared_prior, tuple(pose_priors))
    if problem.count <= problem.size:
        raise BadInput(joint, f"{problem.count} equations of its frequency responses for {problem.size} unknowns")
    values, chi_squared, covariance = _fit(joint, problem)
    asymptotes = [_asymptotes(response) for response in responses]
    return InitialAnalysis(
        mean=values[:SHARED],
        covariance=covariance[:SHARED, :SHARED],
        chi_squared=chi_squared,
        poses=tuple(
            PoseAnalysis(
                pose=tuple(pose),
                response=response,
                load_inertia=float(values[SHARED + 2 * k]),
                fit=_ideal(values, covariance, SHARED + 2 * k),
                asymptotes=read,
            )
            for k, (pose, response, read) in enumerate(zip(poses, responses, asymptotes, strict=True))
        ),
    )


@dataclass(frozen=True)
class _ResponseProblem:
    """Unknowns: the shared ones (5,), then J_l and k_g of each pose; in units of their priors' standard deviations."""

    responses: tuple[FrequencyResponse, ...]
    shared_prior: SharedPrior
    pose_priors: tuple[PosePrior, ...]

    @property
    def size(self) -> int:
        return SHARED + 2 * len(self.responses)

    @property
    def count(self) -> int:
        return sum(2 * len(response.frequency) for response in self.responses)

    @property
    def mean(self) -> Array:
        return np.concatenate([self.shared_prior.mean, *(prior.mean[:2] for prior in self.pose_priors)])

    @property
    def root(self) -> Array:
        """R (size, size) with R R^T the prior covariance."""
        root = np.zeros((self.size, self.size))
        scale = self.shared_prior.sigma
        correlation = self.shared_prior.covariance / np.outer(scale, scale)
        root[:SHARED, :SHARED] = scale[:, None] * np.linalg.cholesky(correlation)
        spread = np.concatenate([prior.sigma[:2] for prior in self.pose_priors])
        root[SHARED:, SHARED:] = np.diag(spread)
        return root

    def starts(self) -> list[Array]:
        """Start values: the prior with several compliances, including that of the highest peaks."""
        loads = np.array([prior.mean[0] for prior in self.pose_priors])
        peaks = np.array([_peak(response) for response in self.responses])
        found = float(np.median(1 / (loads * (2 * np.pi * peaks) ** 2)))
        tried = [0.0 if np.isinf(f) else float(1 / (np.median(loads) * (2 * np.pi * f) ** 2)) for f in FitLimits.starts]
        starts: list[Array] = []
        for compliance in (found, *tried):
            start = self.mean
            start[3] = compliance
            starts.append(start)
        return starts


def _fit(joint: str, problem: _ResponseProblem) -> tuple[Array, float, Array]:
    """Values, chi^2 per degree of freedom, and covariance. BadInput with the joint if the search did not converge."""
    mean, root = problem.mean, problem.root
    inverse_root = np.linalg.inv(root)
    weights = [1 / np.sqrt(response.variance(response.impedance) / 2) for response in problem.responses]

    def residual(x: Array) -> Array:
        return np.concatenate([_misfit(problem, mean + root @ x, weights)[0], x])

    def jacobian(x: Array) -> Array:
        return np.vstack([_misfit(problem, mean + root @ x, weights)[1] @ root, np.eye(len(x))])

    def solve(start: Array) -> SearchResult:
        # evaluations of the residual, in each search
        return optimize.least_squares(residual, start, jac=jacobian, method="lm", max_nfev=100)

    found = min((solve(inverse_root @ (start - mean)) for start in problem.starts()), key=lambda each: each.cost)
    for _ in range(3):  # rounds of fitting and weighing
        values = mean + root @ found.x
        weights[:] = [
            1 / np.sqrt(response.variance(_model(response.frequency, values, SHARED + 2 * k)) / 2)
            for k, response in enumerate(problem.responses)
        ]
        found = solve(found.x)
    converged(found, joint, "its frequency responses")
    x = np.asarray(found.x, dtype=float)
    misfit, _ = _misfit(problem, mean + root @ x, weights)
    chi_squared = float(misfit @ misfit) / (problem.count - problem.size)
    rows = jacobian(x)
    covariance = root @ scaled_inverse(rows.T @ rows) @ root.T
    return mean + root @ x, chi_squared, max(chi_squared, 1.0) * covariance


def _model(frequency: Array, values: Array, own: int) -> Complex:
    return impedance(frequency, TwoMassTrain.of(values), float(values[own]), float(values[own + 1])).total


def _misfit(problem: _ResponseProblem, values: Array, weights: Sequence[Array]) -> tuple[Array, Array]:
    """Weighted real and imaginary parts (count,) of model minus measured Z, and their derivatives (count, size)."""
    train = TwoMassTrain.of(values)
    h, c = train.damping_time, train.compliance
    rows: list[Array] = []
    derivatives: list[Array] = []
    for k, (response, weight) in enumerate(zip(problem.responses, weights, strict=True)):
        own = SHARED + 2 * k
        z = impedance(response.frequency, train, float(values[own]), float(values[own + 1]))
        one, s = np.ones_like(z.s), z.s
        by_load, by_spring = z.by_load(one, 0 * one), z.by_spring(one, 0 * one)
        slope = np.zeros((len(s), problem.size), dtype=np.complex128)
        slope[:, 0], slope[:, 1], slope[:, 2] = s, 1.0, by_load
        slope[:, 3], slope[:, 4] = by_spring * s / (1 + s * h), -by_spring * c * (s / (1 + s * h)) ** 2
        slope[:, own], slope[:, own + 1] = by_load * s, by_load / s
        error = (z.total - response.impedance) * weight
        slope *= weight[:, None]
        rows += [error.real, error.imag]
        derivatives += [slope.real, slope.imag]
    return np.concatenate(rows), np.vstack(derivatives)


def _ideal(values: Array, covariance: Array, own: int) -> Ideal:
    """The pose whose J_l is number `own`; standard deviations to first order."""
    train, load = TwoMassTrain.of(values), float(values[own])
    inertia, friction = train.motor_inertia + load, max(train.motor_friction + train.load_friction, 0.0)
    locked_rotor, corner = train.locked_rotor_frequency(load), friction / (2 * np.pi * inertia)
    by_inertia, by_friction, by_resonance = np.zeros((3, len(values)))
    by_inertia[[0, own]] = 1.0
    by_friction[[1, 2]] = 1.0
    if np.isfinite(locked_rotor):
        by_resonance[3], by_resonance[own] = -1 / (2 * train.compliance), -1 / (2 * load)  # of log f_l
    by_corner = by_friction / max(friction, 1e-300) - by_inertia / inertia  # of log f_c
    rows = np.array([by_inertia, by_friction, by_resonance, by_corner, (by_resonance + by_corner) / 2])
    std = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", rows, covariance, rows), 0.0))
    frequency = float(np.sqrt(locked_rotor * corner))
    return Ideal(
        inertia=Figure(value=inertia, std=float(std[0])),
        friction=Figure(value=friction, std=float(std[1])),
        locked_rotor=_relative(locked_rotor, float(std[2])),
        corner=_relative(corner, float(std[3])),
        frequency=_relative(frequency, float(std[4])),
        sweep_frequency=nearest_line(frequency),
    )


def _relative(value: float, std: float) -> Figure:
    """A value with the standard deviation of its logarithm; an infinite value has none."""
    return Figure(value=value, std=std * value if np.isfinite(value) else np.inf)


def _peak(response: FrequencyResponse) -> float:
    """Frequency of the highest maximum of |Z|/omega within the band, Hz: parabola through three lines in log-log."""
    x, y = np.log(response.frequency), np.log(np.abs(response.impedance) / response.frequency)
    inner = [k for k in range(1, len(x) - 1) if y[k] >= max(y[k - 1], y[k + 1])]
    if not inner:
        return float(response.frequency[int(np.argmax(y))])
    top = max(inner, key=lambda k: float(y[k]))
    (a, b), (u, v) = x[top - 1 : top + 2 : 2] - x[top], y[top - 1 : top + 2 : 2] - y[top]
    curve = (u / a - v / b) / (a - b)
    slope = u / a - curve * a
    return float(np.exp(x[top] - slope / (2 * curve) if curve < 0 else x[top]))


def _asymptotes(response: FrequencyResponse) -> Ideal:
    frequency, z = response.frequency, response.impedance
    variance = response.variance(z)
    omega = 2 * np.pi * frequency
    resonance = _peak(response)
    near = int(np.argmin(np.abs(frequency - resonance)))
    spacing = float(np.mean([b - a for a, b in pairwise(frequency[max(0, near - 1) : near + 2])]))
    level = (frequency >= LEVEL[0] * resonance) & (frequency <= LEVEL[1] * resonance)
    if not level.any():
        level = np.arange(len(frequency)) == 0
    inertia = _weighted(np.abs(z[level]) / omega[level], variance[level] / omega[level] ** 2)
    below = frequency <= max(LEVEL[1] * resonance, frequency[0])
    friction = _weighted(z.real[below], variance[below] / 2)
    friction = Figure(value=max(friction.value, 0.0), std=friction.std)
    corner = friction.value / (2 * np.pi * inertia.value)
    corner_std = float(np.hypot(friction.std / (2 * np.pi * inertia.value), corner * inertia.std / inertia.value))
    ideal = float(np.sqrt(resonance * corner))
    resonance_std = spacing / np.sqrt(12)  # anywhere between two lines
    spread = np.hypot(corner_std / max(corner, 1e-300), resonance_std / resonance) / 2
    return Ideal(
        inertia=inertia,
        friction=friction,
        locked_rotor=Figure(value=resonance, std=float(resonance_std)),
        corner=Figure(value=corner, std=corner_std),
        frequency=Figure(value=ideal, std=float(ideal * spread)),
        sweep_frequency=nearest_line(ideal),
    )


def _weighted(values: Array, variance: Array) -> Figure:
    weight = 1 / np.maximum(variance, 1e-300)
    return Figure(value=float(values @ weight / weight.sum()), std=float(1 / np.sqrt(weight.sum())))
