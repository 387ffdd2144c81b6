r"""Noise and nonlinear distortion apart: sweeps of one pose that differ in their phases alone (`realisations`).

The robust method for the best linear approximation (Pintelon and Schoukens, System Identification, 2012, sec. 4.3.1).
A nonlinearity answers sines at the lines and at other multiples of 1/period. At a line its answer is part linear, the
same for all phases, part of a phase that hangs on all others: over random phases that part has the mean 0 and scatters
like noise, but not between periods. Of M realisations, with D the effort at a line that the linear model leaves,

    s^2 = sum_m |D_m / Omega_m - mean|^2 / (M - 1)    estimates    (noise^2 + distortion^2) / |Omega|^2 .

The noise is what differs between the P periods of a window: the bins that are no multiple of 1/period, of them those
nearer to this multiple than to another. What the model leaves has no ripple and no drift of gravity in it, which would
pass for noise; what the sweep's own parameters took of the noise is given back by their leverage. At multiples of
1/period without a sine there is nothing but noise and distortion.

The axis' friction distorts in all poses: variances of effort are pooled over the groups of an axis, weighted by their
degrees of freedom. A fitted inertia or stiffness of its own takes part of each sweep's distortion; D has it back.
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

SAME = 1e-6  # relative, of frequencies and amplitudes; phases, rad
RANK = 1e-6  # of the largest singular value: own parameters that no bin tells apart count as one
LEAST = 0.05  # part of a bin that counts as free, at the least


@dataclass(frozen=True)
class Distortion:
    """Of one axis, at the multiples (h,) of 1/period in use: standard deviation of the real and of the imaginary part
    of an effort bin, N m (N). `realisations`: the most in one pose; `groups`: poses that have some.
    """

    frequency: Array
    noise: Array
    distortion: Array
    realisations: int
    groups: int

    def spread(self, spectrum: Spectrum) -> Array:
        """Standard deviation of each bin (b,) over the noise."""
        ratio = np.ones(len(spectrum.frequency))
        for frequency, noise, distortion in zip(self.frequency, self.noise, self.distortion, strict=True):
            ratio[np.abs(spectrum.frequency - frequency) < SAME * frequency] = np.hypot(1.0, distortion / noise)
        return ratio


def distortion_of(
    spectra: Sequence[Spectrum], uncertain: Sequence[Complex], fit: JointFit, before: Distortion | None = None
) -> Distortion | None:
    """From the sweeps of one axis and their joint fit, made with the distortion known `before`.

    None where no two sweeps are realisations of one.
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
            beside = (np.abs(number - number[place]) <= periods // 2) & (number % periods != 0)
            if not beside.any():
                continue
            frequency = round(float(one.frequency[place]), 9)
            freedom = float(np.sum([one_free[beside] for one_free in free]))
            noise = float(np.sum([np.abs(rest[beside]) ** 2 for rest in left])) / freedom
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
    """Numbers of the sweeps that differ in their phases alone, two and more."""
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
    """Whether no two neighbours have the same phases: repeats tell nothing of distortion."""
    phases = sorted(tuple(sine.phase for sine in one.spec.sines) for one in spectra)
    return all(np.abs(np.subtract(one, other)).max() > SAME for one, other in pairwise(phases))


def _left(
    spectrum: Spectrum, uncertain: Complex, fit: JointFit, number: int, before: "Distortion | None"
) -> tuple[Complex, Complex, Array]:
    """Effort that the fit leaves of a sweep (b,), how it hangs on its load inertia and gravity stiffness (2, b), and
    what part of each bin its own parameters left free (b,).
    """
    (stack,) = stacks([spectrum], [uncertain])
    residual, _, by_own = stack_residual(stack, fit.shared, fit.own[number][None])
    weight = 1 / (np.ones(len(spectrum.frequency)) if before is None else before.spread(spectrum))
    columns = np.concatenate([(by_own[0] * weight).real, (by_own[0] * weight).imag], axis=1).T  # (2 b, p)
    length = np.linalg.norm(columns, axis=0)
    basis, singular, _ = np.linalg.svd(columns / np.where(length > 0, length, 1.0), full_matrices=False)
    taken = np.sum(basis[:, singular > RANK * singular[0]] ** 2, axis=1)
    parts = taken.reshape(2, -1).sum(axis=0)
    return residual[0], by_own[0, :2], np.maximum(1 - parts / 2, LEAST)


def _mean(values: Sequence[tuple[float, float]]) -> float:
    return sum(value * weight for value, weight in values) / sum(weight for _, weight in values)
