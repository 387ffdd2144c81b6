"""All sweeps of one axis fitted together: the drive train is shared, the load inertia belongs to the pose.

The equations are those of `drive_train`. Gauss-Newton with Levenberg's damping on the real and imaginary parts, with
one additional row for every prior of the data sheet. The own parameters are eliminated sweep by sweep (Schur
complement), so the cost grows linearly with the number of sweeps. Where some sweeps have a direct encoder and some not,
what the encoder says of the spring is a prior of all. The noise variance is pooled over the sweeps of
one sample rate, from residuals corrected for the degrees of freedom.

Known effects are removed before (`known_effects`); their uncertainty enters as further shared parameters, 0 +- 1.

A sweep whose residual is larger than chance allows (a torque spike, a collision, a loose cable) would distort the
drive train and the noise of all sweeps. It gets the variance of its own residual, the most probable one for an
additional Gaussian error (`weight` = pooled over own variance). Chance: chi-squared at `CHANCE` over the number of
sweeps.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import cast

import numpy as np
from scipy.linalg import block_diag
from scipy.special import chdtri

from service import BadInput
from service.identification.axis.drive_train import (
    SHARED,
    Stack,
    TwoMassTrain,
    direct_terms,
    spring,
    stack_residual,
    stacks,
)
from service.identification.axis.nominal_priors import PosePrior, SharedPrior
from service.identification.model import finite, scaled_inverse, scaled_solution
from service.identification.spectra.frequency_response import Spectrum
from service.model import Array, Complex, Mask


@dataclass(frozen=True)
class FitLimits:
    """How the joint fit searches and judges."""

    free: float = 10.0  # times the largest effort bin: one sigma of unknown parameters
    iterations: int = 60  # of Gauss-Newton, each with its damping
    gained: float = 1e-9  # of the cost: a step that gains less ends the search
    rounds: int = 4  # of fitting and estimating the noise
    starts: tuple[float, ...] = (np.inf, 25.0, 16.0, 11.0, 8.0, 6.0)  # Hz, locked-rotor frequencies tried as start
    few_freedom: float = 4.0  # degrees of freedom; with fewer, the noise cannot be estimated and the guess is used
    chance: float = 0.01  # probability that any sweep of an axis is suspected although all are correct
    material: float = 1e-3  # of the largest effort bin: smaller residuals are not tested


class FitEnded(Enum):
    """How a minimisation ended."""

    CONVERGED = f"a further step gains less than {FitLimits.gained:g} of the cost"
    AT_REST = "no step, however short, lowers the cost"
    UNFINISHED = f"the cost still falls after {FitLimits.iterations} steps"
    LOST = "the steps leave the range of numbers"


@dataclass(frozen=True)
class JointFit:
    """Result for n sweeps of one axis, in the order given.

    `inertia` (n,) = Jm + J_l, `covariance` (n, n) of it; `own_variance` (n,) is the part of each sweep itself, the
    rest comes from the shared drive train. `bound` (n,): Cramer-Rao bound of its standard deviation if all but J_l
    were known. `gravity` (n, 2): fitted k_g and G0. `noise` (n,): standard deviation of real and imaginary part of
    an effort bin. `chi_squared` (n,): share of each sweep, per degree of freedom, with the pooled noise. `weight`
    (n,): below 1 if the residual of the sweep itself is used instead. `freedom`: total degrees of freedom. `moved`
    (u,): change of each independent part of the known effects, in its standard deviations.
    """

    train: TwoMassTrain
    train_std: Array
    load_inertia: Array
    gravity: Array
    inertia: Array
    covariance: Array
    own_variance: Array
    bound: Array
    noise: Array
    chi_squared: Array
    weight: Array
    freedom: float
    moved: Array
    by_shared: Array  # (n, 5 + u) derivatives of `inertia` by all shared parameters, and
    precision: Array  # (5 + u, 5 + u) of those: what these sweeps and the prior say of them
    shared: Array  # (5 + u,) and
    own: tuple[Array, ...]  # of each sweep (p,): all parameters, for `drive_train`
    ended: FitEnded
    noise_change: Array  # (n,) relative change of `noise` in the last of the `ROUNDS`
    parts: tuple[Stack, ...]  # what was fitted, for `fit_again`
    priors: "Priors"
    point: "Point"


@dataclass(frozen=True)
class Priors:
    """Of shared and own parameters."""

    mean: Array  # (5 + u,)
    precision: Array  # (5 + u, 5 + u)
    own_mean: tuple[Array, ...]  # a stack (n, p) each
    own_precision: tuple[Array, ...]


@dataclass(frozen=True)
class Point:
    """Values of all parameters."""

    shared: Array  # (5 + u,)
    own: tuple[Array, ...]  # a stack (n, p) each


@dataclass(frozen=True)
class _Normal:
    """Normal equations of n sweeps, bordered: own blocks, couplings, shared block and the gradient of each."""

    own: Array  # (n, p, p)
    coupling: Array  # (n, p, 5 + u)
    shared: Array  # (5 + u, 5 + u)
    own_gradient: Array  # (n, p)
    shared_gradient: Array  # (5 + u,)

    @property
    def finite(self) -> bool:
        parts = (self.own, self.coupling, self.shared, self.own_gradient, self.shared_gradient)
        return all(bool(np.isfinite(part).all()) for part in parts)


@dataclass(frozen=True)
class _Minimum:
    point: Point
    cost: float  # squared standard deviations
    ended: FitEnded


@dataclass(frozen=True)
class _Noise:
    sigma: Array  # (n,) of all sweeps, as used
    chi_squared: Array
    weight: Array
    freedom: float


def fit_axis(
    spectra: Sequence[Spectrum],
    shared_prior: SharedPrior,
    pose_priors: Sequence[PosePrior],
    noise_guess: float,
    uncertain: Sequence[Complex] | None = None,
    spread: Sequence[Array] | None = None,
) -> JointFit:
    """Fit all periodic sweeps of one axis; `noise_guess` is the effort noise of one sample, N m (N).

    `uncertain` (u, b) of each sweep: uncertainty of the effects removed from its effort. `spread` (b,) of each sweep:
    standard deviation of each bin over the noise, larger than 1 with nonlinear distortion (`axis_estimate`).
    BadInput, and no result, if the cost is not finite, if it still decreases after the last step, or if a step or
    a variance is not finite.
    """
    known = list(uncertain or [np.zeros((0, len(one.frequency)), dtype=np.complex128) for one in spectra])
    poses = [complete_prior(*pair) for pair in zip(spectra, pose_priors, strict=True)]
    sigma = np.array([noise_guess / np.sqrt(2 * spectrum.samples) for spectrum in spectra])
    # about 24 sweeps choose between the starts
    some = slice(None, None, max(1, len(spectra) // 24))
    wide = list(spread or [np.ones(len(one.frequency)) for one in spectra])
    shared = _first_train(stacks(spectra[some], known[some], wide[some]), shared_prior, poses[some], sigma[some])
    parts = stacks(spectra, known, wide)
    priors = _priors(parts, shared_prior, poses)
    point = Point(shared, priors.own_mean)
    rate = np.array([spectrum.spec.sample_rate for spectrum in spectra])
    noise = _Noise(sigma, np.ones(len(spectra)), np.ones(len(spectra)), 0.0)
    ended, before = FitEnded.UNFINISHED, noise
    nominal = priors
    mixed = len({stack.load_velocity is None for stack in parts}) > 1
    for count in range(FitLimits.rounds):
        if mixed and count:
            priors = _with_encoder(parts, nominal, priors, noise.sigma, point)
        minimum = _minimise(parts, priors, noise.sigma, point, FitLimits.iterations)
        if minimum.ended is FitEnded.LOST or not np.isfinite(minimum.cost):
            what = "has no finite residual or derivative: effort, motion or prior overflow"
            raise BadInput(_not_finite(spectra, parts, point), what)
        point, ended = minimum.point, minimum.ended
        before, noise = noise, _pooled_noise(parts, priors, noise.sigma, point, rate, noise_guess)
    if ended is FitEnded.UNFINISHED:
        raise BadInput(spectra[0].spec.axis, f"its fit over {len(spectra)} sweeps did not converge: {ended.value}")
    result = replace(_result(parts, priors, noise, point, ended), noise_change=np.abs(noise.sigma / before.sigma - 1))
    for one, value, variance in zip(spectra, result.inertia, np.diag(result.covariance), strict=True):
        finite(np.array([value, variance]), f"sweep {one.spec.id} of {one.spec.axis}", "its inertia with its variance")
    return result


def fit_sweep(
    spectrum: Spectrum,
    mean: Array,
    precision: Array,
    prior: PosePrior,
    noise: float,
    uncertain: Complex,
    spread: Array | None = None,
) -> JointFit | None:
    """One sweep with lines. `mean` (5 + u,) and `precision` (5 + u, 5 + u): what the sweeps before it say of the shared
    parameters; those of the result contain all. `noise`: of an effort bin, N m (N).

    None if the fit did not end at a minimum.
    """
    parts = stacks([spectrum], [uncertain], None if spread is None else [spread])
    own = complete_prior(spectrum, prior)
    priors, sigma = Priors(mean, precision, (own.mean[None],), (own.sigma[None] ** -2.0,)), np.array([noise])
    return _fit_from(parts, priors, sigma, Point(mean, priors.own_mean))


def fit_again(fit: JointFit, added: Sequence[JointFit], ratio: float) -> JointFit | None:
    """All sweeps of a fit with those `added` to it, each by `fit_sweep`, if the noise has `ratio` times the variance
    assumed so far. It begins at the last one of them. None if it did not end at a minimum.
    """
    parts, own = list(fit.parts), list(fit.point.own)
    mean, precision = list(fit.priors.own_mean), list(fit.priors.own_precision)
    for number, one in enumerate(added):
        (stack,) = one.parts
        stack = replace(stack, place=np.array([len(fit.inertia) + number]))
        same = [k for k, part in enumerate(parts) if part.shape == stack.shape]
        if not same:
            return None
        k = same[0]
        parts[k] = parts[k].and_more(stack)
        for values, of in ((own, one.point.own), (mean, one.priors.own_mean), (precision, one.priors.own_precision)):
            values[k] = np.concatenate([values[k], of[0]])
    priors = replace(fit.priors, own_mean=tuple(mean), own_precision=tuple(precision))
    sigma = np.concatenate([one.noise for one in (fit, *added)]) * np.sqrt(ratio)
    start = Point([fit, *added][-1].shared, tuple(own))
    found = _fit_from(tuple(parts), priors, sigma, start)
    return found and replace(found, weight=np.concatenate([one.weight for one in (fit, *added)]), freedom=fit.freedom)


def _fit_from(parts: Sequence[Stack], priors: Priors, sigma: Array, start: Point) -> JointFit | None:
    """With known noise; every sweep has the weight 1."""
    found = _minimise(parts, priors, sigma, start, FitLimits.iterations)
    if found.ended not in (FitEnded.CONVERGED, FitEnded.AT_REST):
        return None
    squares, freedom, samples, _ = _left_over(parts, priors, sigma, found.point, 0.0)
    ratio = squares / samples / sigma**2 / np.maximum(freedom, 1.0)
    told = _Noise(sigma, ratio, np.ones(len(sigma)), float(freedom.sum()))
    return _result(parts, priors, told, found.point, found.ended)


def _not_finite(spectra: Sequence[Spectrum], parts: Sequence[Stack], point: Point) -> str:
    """The sweep whose residual is not finite, else the axis."""
    for stack, own in zip(parts, point.own, strict=True):
        spoiled = ~np.isfinite(stack_residual(stack, point.shared, own)[0]).all(axis=1)
        for place in cast(list[int], stack.place[spoiled].tolist()):
            return f"sweep {spectra[place].spec.id} of {spectra[place].spec.axis}"
    return spectra[0].spec.axis


def complete_prior(spectrum: Spectrum, prior: PosePrior) -> PosePrior:
    """The prior with a wide one for the own parameters that no model predicts; it only matters if there are few
    bins.
    """
    wide = FitLimits.free * float(np.abs(spectrum.effort).max())
    slope = wide / (2 * np.pi * float(spectrum.frequency[-1]))
    unknown = np.array([wide, slope, *(wide for _ in direct_terms(spectrum))])
    return PosePrior(np.concatenate([prior.mean, np.zeros_like(unknown)]), np.concatenate([prior.sigma, unknown]))


def _priors(parts: Sequence[Stack], shared: SharedPrior, poses: Sequence[PosePrior]) -> Priors:
    own = [[poses[place] for place in cast(list[int], stack.place.tolist())] for stack in parts]
    unknown = parts[0].uncertain.shape[1]
    return Priors(
        np.append(shared.mean, np.zeros(unknown)),
        block_diag(scaled_inverse(shared.covariance), np.eye(unknown)),
        tuple(np.stack([prior.mean for prior in priors]) for priors in own),
        tuple(np.stack([prior.sigma**-2.0 for prior in priors]) for priors in own),
    )


def _first_train(parts: Sequence[Stack], shared: SharedPrior, poses: Sequence[PosePrior], sigma: Array) -> Array:
    """The drive train (5,) of the best of several starts, used as start of the fit."""
    priors = _priors(parts, shared, poses)
    starts = FitLimits.starts if any(stack.load_velocity is None for stack in parts) else FitLimits.starts[:1]
    # few iterations show the lowest minimum
    tries = [_minimise(parts, priors, sigma, _start(priors, frequency), 8) for frequency in starts]
    finite = [one for one in tries if np.isfinite(one.cost)] or tries
    return min(finite, key=lambda one: one.cost).point.shared


def _start(priors: Priors, locked_rotor: float) -> Point:
    """At the prior's spring for inf, otherwise at the spring of a locked-rotor frequency."""
    shared = priors.mean.copy()
    if np.isfinite(locked_rotor):
        typical = float(np.median(np.concatenate([mean[:, 0] for mean in priors.own_mean])))
        shared[3] = 1 / (typical * (2 * np.pi * locked_rotor) ** 2)
    return Point(shared, priors.own_mean)


def _equations(parts: Sequence[Stack], priors: Priors, sigma: Array, point: Point) -> tuple[float, tuple[_Normal, ...]]:
    """Cost at a point, in squared standard deviations, and the normal equations there."""
    away = point.shared - priors.mean
    cost = float(away @ priors.precision @ away)
    normals: list[_Normal] = []
    for stack, own, mean, precision in zip(parts, point.own, priors.own_mean, priors.own_precision, strict=True):
        scale = 1 / (sigma[stack.place][:, None, None] * np.repeat(stack.spread, 2, axis=1)[:, None])
        residual, by_shared, by_own = stack_residual(stack, point.shared, own)
        r, a, b = (_real(part) * scale for part in (residual[:, None], by_shared, by_own))
        pull = precision * (mean - own)
        matrix = b @ b.transpose(0, 2, 1)
        matrix[:, range(own.shape[1]), range(own.shape[1])] += precision
        turned = a.transpose(0, 2, 1)
        normals.append(
            _Normal(
                own=matrix,
                coupling=b @ turned,
                shared=(a @ turned).sum(axis=0),
                own_gradient=(b @ r.transpose(0, 2, 1))[:, :, 0] + pull,
                shared_gradient=(a @ r.transpose(0, 2, 1)).sum(axis=0)[:, 0],
            )
        )
        cost += float(np.sum(r**2)) + float(np.sum(precision * (own - mean) ** 2))
    return cost, tuple(normals)


def _minimise(parts: Sequence[Stack], priors: Priors, sigma: Array, point: Point, iterations: int) -> _Minimum:
    """The point of least cost, starting at `point`. A step to a point whose cost is not a number is rejected."""
    damping, ended = 1e-3, FitEnded.UNFINISHED  # of the diagonal
    cost, normals = _equations(parts, priors, sigma, point)
    for _ in range(iterations if np.isfinite(cost) else 0):
        if not all(each.finite for each in normals):
            ended = FitEnded.LOST  # squares of derivatives overflow: there is no step
            break
        while True:
            trial = _step(normals, priors, point, damping)
            trial_cost, trial_normals = _equations(parts, priors, sigma, trial)
            if trial_cost <= cost or damping > 1e8:
                break
            damping *= 10
        if not trial_cost <= cost:
            ended = FitEnded.AT_REST if np.isfinite(trial_cost) else FitEnded.LOST
            break
        gained, point, cost, normals = cost - trial_cost, trial, trial_cost, trial_normals
        damping = max(damping / 10, 1e-12)
        if gained < FitLimits.gained * (1 + cost):
            ended = FitEnded.CONVERGED
            break
    return _Minimum(point, cost, ended)


def _step(normals: Sequence[_Normal], priors: Priors, point: Point, damping: float) -> Point:
    matrix = priors.precision.copy()
    gradient = priors.precision @ (priors.mean - point.shared)
    eliminated: list[tuple[Array, Array]] = []
    for normal in normals:
        size = range(normal.own.shape[1])
        own = normal.own.copy()
        own[:, size, size] *= 1 + damping
        solved = scaled_solution(own, np.concatenate([normal.coupling, normal.own_gradient[:, :, None]], axis=2))
        gain, step = solved[:, :, :-1], solved[:, :, -1]
        matrix += normal.shared - np.einsum("npi,npj->ij", normal.coupling, gain)
        gradient += normal.shared_gradient - np.einsum("npi,np->i", gain, normal.own_gradient)
        eliminated.append((step, gain))
    shared_step = scaled_inverse(matrix + damping * np.diag(np.diag(matrix))) @ gradient
    own = tuple(values + step - gain @ shared_step for values, (step, gain) in zip(point.own, eliminated, strict=True))
    return Point(point.shared + shared_step, own)


def _pooled_noise(
    parts: Sequence[Stack], priors: Priors, sigma: Array, point: Point, rate: Array, guess: float
) -> _Noise:
    """The noise estimated from the residuals at a point; `sigma` (n,) is the noise assumed so far."""
    count = len(rate)
    squares, freedom, samples, largest = _left_over(parts, priors, sigma, point, SHARED / count)
    variance, sound = np.empty(count), np.ones(count, dtype=bool)
    for value in np.unique(rate):
        same = rate == value
        variance[same], sound[same] = _pool(
            squares[same], freedom[same], samples[same] * (FitLimits.material * largest[same]) ** 2, guess
        )
    # rounding, for simulations without noise
    sigma = np.maximum(np.sqrt(variance / samples), 1e-7 * largest)
    ratio = squares / samples / sigma**2 / np.maximum(freedom, 1.0)
    weight = np.where(sound, 1.0, 1 / np.maximum(ratio, 1.0))
    return _Noise(sigma / np.sqrt(weight), ratio, weight, float(freedom[sound].sum()))


def _left_over(parts: Sequence[Stack], priors: Priors, sigma: Array, point: Point, shared: float) -> Array:
    """(4, n) of each sweep: squared residual of a sample, degrees of freedom after `shared` ones for the drive train,
    samples, and largest effort bin.
    """
    squares, freedom, samples, largest = told = np.zeros((4, len(sigma)))
    normals = _equations(parts, priors, sigma, point)[1]
    for stack, own, normal, precision in zip(parts, point.own, normals, priors.own_precision, strict=True):
        residual = stack_residual(stack, point.shared, own)[0] / stack.spread
        squares[stack.place] = np.sum(np.abs(residual) ** 2, axis=1) * stack.samples
        # a parameter takes the fraction of a degree of freedom that data, not its prior, determine; the train is shared
        by_prior = np.sum(precision * np.diagonal(scaled_inverse(normal.own), axis1=1, axis2=2), axis=1)
        freedom[stack.place] = 2 * residual.shape[1] - (stack.parameters - by_prior) - shared
        samples[stack.place], largest[stack.place] = stack.samples, stack.largest
    return told


def _pool(squares: Array, freedom: Array, immaterial: Array, guess: float) -> tuple[float, Mask]:
    """Variance of the sweeps (n,) of one sample rate, and which of them are correct: not worse than by chance."""
    everyone = np.ones(len(squares), dtype=bool)
    if freedom.sum() < FitLimits.few_freedom:
        return guess**2 / 2, everyone
    each = squares / np.maximum(freedom, 1.0)
    worst = chdtri(np.maximum(freedom, 1.0), FitLimits.chance / len(squares)) / np.maximum(freedom, 1.0)
    variance = float(np.median(each))  # half of the sweeps may be faulty
    sound = everyone
    for _ in range(10):  # rounds to select the sweeps that share the noise
        before, sound = sound, (each <= worst * variance) | (each <= immaterial)
        variance = float(squares[sound].sum() / freedom[sound].sum())
        if np.array_equal(before, sound):
            break
    return variance, sound


@dataclass(frozen=True)
class _Uncertainty:
    """At a point: precision (5 + u, 5 + u) and covariance of the shared parameters; of each stack the inverse
    (n, p, p) of the own block, and by how much own parameters follow the shared ones, (n, p, 5 + u).
    """

    precision: Array
    covariance: Array
    inverses: tuple[Array, ...]
    follow: tuple[Array, ...]
    normals: tuple[_Normal, ...]

    @classmethod
    def at(cls, parts: Sequence[Stack], priors: Priors, sigma: Array, point: Point) -> "_Uncertainty":
        normals = _equations(parts, priors, sigma, point)[1]
        inverses = tuple(scaled_inverse(normal.own) for normal in normals)
        follow = tuple(-inverse @ normal.coupling for inverse, normal in zip(inverses, normals, strict=True))
        matrix = priors.precision.copy()
        for normal, by in zip(normals, follow, strict=True):
            matrix += normal.shared + np.einsum("npi,npj->ij", normal.coupling, by)
        return cls(matrix, scaled_inverse(matrix), inverses, follow, normals)

    def spring(self, parts: Sequence[Stack], point: Point) -> tuple[Array, Array]:
        """[c, h] and their covariance from the stacks with a direct encoder."""
        direct = [k for k, stack in enumerate(parts) if stack.load_velocity is not None]
        steps = np.linalg.cholesky(self.covariance).T
        moves = [(step, [self.follow[k] @ step for k in direct]) for step in steps]
        return spring([parts[k] for k in direct], point.shared, [point.own[k] for k in direct], moves)


def _with_encoder(parts: Sequence[Stack], nominal: Priors, priors: Priors, sigma: Array, point: Point) -> Priors:
    """The nominal priors and what direct encoders say of the spring: their sweeps' effort alone does not show it."""
    values, covariance = _Uncertainty.at(parts, priors, sigma, point).spring(parts, point)
    told = np.zeros_like(nominal.precision)
    told[3:SHARED, 3:SHARED] = scaled_inverse(covariance)
    precision = nominal.precision + told
    right = nominal.precision @ nominal.mean + told[:, 3:SHARED] @ values
    return replace(nominal, mean=scaled_inverse(precision) @ right, precision=precision)


def _result(parts: Sequence[Stack], priors: Priors, noise: _Noise, point: Point, ended: FitEnded) -> JointFit:
    count = len(noise.sigma)
    load, own_variance, bound = np.zeros((3, count))
    gravity, by_shared = np.zeros((count, 2)), np.zeros((count, len(point.shared)))
    known = _Uncertainty.at(parts, priors, noise.sigma, point)
    for stack, own, normal, inverse, follow, precision in zip(
        parts, point.own, known.normals, known.inverses, known.follow, priors.own_precision, strict=True
    ):
        by_shared[stack.place] = follow[:, 0]  # d J_l / d shared
        own_variance[stack.place] = inverse[:, 0, 0]
        told = normal.own[:, 0, 0] - precision[:, 0]
        # least information of the data, relative to the prior's
        bound[stack.place] = 1 / np.sqrt(np.maximum(told, 1e-12 * precision[:, 0]))
        load[stack.place], gravity[stack.place] = own[:, 0], own[:, 1:3]
    by_shared[:, 0] += 1  # J = Jm + J_l
    shared, shared_std = point.shared[:SHARED].copy(), np.sqrt(np.diag(known.covariance))[:SHARED]
    if all(stack.load_velocity is not None for stack in parts):  # the inertias did not need the spring
        shared[3:], covariance = known.spring(parts, point)
        shared_std[3:] = np.sqrt(np.diag(covariance))
    return JointFit(
        train=TwoMassTrain.of(shared),
        train_std=shared_std,
        load_inertia=load,
        gravity=gravity,
        inertia=load + float(shared[0]),
        covariance=by_shared @ known.covariance @ by_shared.T + np.diag(own_variance),
        own_variance=own_variance,
        bound=bound,
        noise=noise.sigma,
        chi_squared=noise.chi_squared,
        weight=noise.weight,
        freedom=noise.freedom,
        moved=point.shared[SHARED:],
        by_shared=by_shared,
        precision=known.precision,
        shared=point.shared,
        own=_by_sweep(parts, point),
        ended=ended,
        noise_change=np.zeros(count),
        parts=tuple(parts),
        priors=priors,
        point=point,
    )


def _by_sweep(parts: Sequence[Stack], point: Point) -> tuple[Array, ...]:
    """The own parameters of each sweep, in the order given."""
    found = {
        place: values
        for stack, own in zip(parts, point.own, strict=True)
        for place, values in zip(cast(list[int], stack.place.tolist()), own, strict=True)
    }
    return tuple(found[place] for place in sorted(found))


def _real(values: Complex) -> Array:
    """(n, p, b) complex as (n, p, 2 b) real; real and imaginary part of a bin are adjacent."""
    return np.ascontiguousarray(values).view(np.float64)


def real_parts(values: Complex) -> Array:
    return np.concatenate([values.real, values.imag])
