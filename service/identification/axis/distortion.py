"""Separates noise and nonlinear distortion: sweeps of one pose that differ only in their phases (`realisations`).

The robust method for the best linear approximation (Pintelon and Schoukens, System Identification, 2012, sec.
4.3.1). A nonlinearity responds to sines at the lines and at other multiples of 1/period. At a line, part of its
response is linear and equal for all phases; the phase of the other part depends on all other phases. Over random
phases that part has the mean 0 and scatters like noise, but not between periods. Of M realisations, with D the
effort at a line that the linear model does not explain,

    s^2 = sum_m |D_m / Omega_m - mean|^2 / (M - 1)    estimates    (noise^2 + distortion^2) / |Omega|^2 .

The noise is the difference between the P periods of a window: the bins that are no multiple of 1/period; for each
multiple those that are nearest to it. The residual of the model contains no ripple and no drift of gravity, which would
be taken for noise. The noise absorbed by the sweep's own parameters is restored by their leverage. Multiples of
1/period without a sine contain only noise and distortion.

The friction of the axis distorts in all poses: variances of effort are pooled over the groups of an axis, weighted
by their degrees of freedom. A fitted inertia or stiffness of a sweep absorbs part of its distortion; D contains it
again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from service.identification.axis.joint_fit import JointFit
from service.identification.axis.sweep_model import stack_residual, stacks
from service.identification.spectra.frequency_response import Complex, Spectrum

Array = NDArray[np.float64]

SAME_SINES = 1e-6  # relative, of frequencies and amplitudes; phases, rad
RANK = 1e-6  # of the largest singular value: own parameters that no bin separates count as one
LEAST_FREE = 0.05  # least part of a bin that counts as free


@dataclass(frozen=True)
class Distortion:
    """Distortion of one axis, at the multiples (h,) of 1/period in use: standard deviation of the real and of the
    imaginary part of an effort bin, N m (N). `realisations`: largest number in one pose; `groups`: number of poses
    with several.
    """

    frequency: Array
    noise: Array
    distortion: Array
    realisations: int
    groups: int

    def spread(self, spectrum: Spectrum) -> Array:
        """Standard deviation of each bin (b,) relative to the noise."""
        ratio = np.ones(len(spectrum.frequency))
        for frequency, noise, distortion in zip(self.frequency, self.noise, self.distortion, strict=True):
            ratio[np.abs(spectrum.frequency - frequency) < SAME_SINES * frequency] = np.hypot(1.0, distortion / noise)
        return ratio


def distortion_of(
    spectra: Sequence[Spectrum], uncertain: Sequence[Complex], fit: JointFit, before: Distortion | None = None
) -> Distortion | None:
    """Distortion from the sweeps of one axis and their joint fit, which was made with the distortion `before`.

    None if no two sweeps are realisations of one sweep.
    """
    groups = _groups(spectra)
    if not groups:
        return None
    squares: dict[float, list[tuple[float, float]]] = {}  # by frequency: excess variance of effort, its weight
    noises: dict[float, list[tuple[float, float]]] = {}
    for members in groups:
        left, by_load, free = zip(*(_left(spectra[k], uncertain[k], fit, k, before) for k in members), strict=True)
        mean = np.mean([fit.own[k][:2] for k in members], axis=0)
        full = [
            rest + (fit.own[k][:2] - mean) @ columns for rest, columns, k in zip(left, by_load, members, strict=True)
        ]
        one = spectra[members[0]]
        period, periods = one.spec.period or 1.0, one.spec.periods or 1
        number = np.round(one.frequency * period * periods).astype(int)
        for place in np.flatnonzero(number % periods == 0):
            between = (np.abs(number - number[place]) <= periods // 2) & (number % periods != 0)
            if not between.any():
                continue
            frequency = round(float(one.frequency[place]), 9)
            freedom = float(np.sum([one_free[between] for one_free in free]))
            noise = float(np.sum([np.abs(rest[between]) ** 2 for rest in left])) / freedom
            noises.setdefault(frequency, []).append((noise, freedom))
            if one.line[place]:
                answer = np.array(
                    [rest[place] / spectra[k].velocity[place] for rest, k in zip(full, members, strict=True)]
                )
                size = float(np.mean([np.abs(spectra[k].velocity[place]) ** 2 for k in members]))
                total, freedom = float(np.var(answer, ddof=1)) * size, len(members) - 1
            else:
                freedom = float(np.sum([one_free[place] for one_free in free]))
                total = float(np.sum([np.abs(rest[place]) ** 2 for rest in left])) / freedom
            squares.setdefault(frequency, []).append((total - noise, freedom))
    frequencies = sorted(squares)
    return Distortion(
        frequency=np.array(frequencies),
        noise=np.array([np.sqrt(_mean(noises[f]) / 2) for f in frequencies]),
        distortion=np.array([np.sqrt(max(_mean(squares[f]), 0.0) / 2) for f in frequencies]),
        realisations=max(len(members) for members in groups),
        groups=len(groups),
    )


def _groups(spectra: Sequence[Spectrum]) -> list[list[int]]:
    """Numbers of the sweeps that differ only in their phases, two or more."""
    alike: dict[tuple[object, ...], list[int]] = {}
    for k, one in enumerate(spectra):
        spec = one.spec
        if (spec.periods or 0) < 2:
            continue
        sines = tuple((round(sine.frequency, 6), float(f"{sine.amplitude:.6g}")) for sine in spec.sines)
        key = (tuple(np.round(spec.pose, 3)), float(f"{spec.offset_velocity:.6g}"), sines, spec.period, spec.periods)
        alike.setdefault((*key, one.samples), []).append(k)
    return [members for members in alike.values() if len(members) > 1 and _differ([spectra[k] for k in members])]


def _differ(spectra: Sequence[Spectrum]) -> bool:
    """Whether no two neighbours have the same phases: repeats contain no information on distortion."""
    phases = sorted(tuple(sine.phase for sine in one.spec.sines) for one in spectra)
    return all(np.abs(np.subtract(one, other)).max() > SAME_SINES for one, other in pairwise(phases))


def _left(
    spectrum: Spectrum, uncertain: Complex, fit: JointFit, number: int, before: "Distortion | None"
) -> tuple[Complex, Complex, Array]:
    """Effort of a sweep not explained by the fit (b,), its derivatives by load inertia and gravity stiffness (2, b),
    and the part of each bin that its own parameters left free (b,).
    """
    (stack,) = stacks([spectrum], [uncertain])
    residual, _, by_own = stack_residual(stack, fit.shared, fit.own[number][None])
    weight = 1 / (np.ones(len(spectrum.frequency)) if before is None else before.spread(spectrum))
    columns = np.concatenate([(by_own[0] * weight).real, (by_own[0] * weight).imag], axis=1).T  # (2 b, p)
    length = np.linalg.norm(columns, axis=0)
    basis, singular, _ = np.linalg.svd(columns / np.where(length > 0, length, 1.0), full_matrices=False)
    taken = np.sum(basis[:, singular > RANK * singular[0]] ** 2, axis=1)
    parts = taken.reshape(2, -1).sum(axis=0)
    return residual[0], by_own[0, :2], np.maximum(1 - parts / 2, LEAST_FREE)


def _mean(values: Sequence[tuple[float, float]]) -> float:
    return sum(value * weight for value, weight in values) / sum(weight for _, weight in values)
