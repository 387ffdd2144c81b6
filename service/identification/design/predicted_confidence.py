r"""Predicted confidence of the inertia over the workspace for a choice of poses, before the measurement.

Sines of amplitude a_i [rad/s] at omega_i over N samples of effort noise s show, in the imaginary part of the response,

    Im Z_i = omega_i J - k_g / omega_i + omega_i^3 J_l^2 c        each with   var = 2 s^2 / (N a_i^2)

(`axis_inertia` for small compliance c). If only J is unknown, this is the Cramer-Rao bound  var J = 2 s^2 / (N sum
omega_i^2 a_i^2). Near a known locked-rotor frequency f, all three are multiplied by F_i^2 = (1 - (f_i / f)^2)^-2.
The gravity stiffness k_g has its prior, separately for each sweep, and is eliminated; the compliance c is shared by
all sweeps of an axis and stays as an unknown in addition to the base parameters beta, J = w beta. The information of
all sweeps on (beta, c) adds up:  Lambda = [[A, B], [B', C]].  The confidence is the largest standard deviation of J
over the workspace and the axes, in percent of J, conditional on the torque gain.

The estimate states a confidence only if it determines all beta. In directions in which the data are not better than
the nominal model it keeps that model (`least_squares`). `determined` is the rule of the estimate: the same function,
with the information on beta alone,  A - B C^-1 B',  and the spread of the nominal model.

The noise is an assumption before the measurement: white, of a drive that samples at NOISE_RATE and averages
down to the requested rate, so that the noise at a line does not depend on that rate.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from service.identification.design.pose_selection import SINGULAR
from service.identification.model.least_squares import Information
from service.model.recording import Sine

Array = NDArray[np.float64]

EFFORT_NOISE = 0.002  # of the rated effort, of one sample at NOISE_RATE
NOISE_RATE = 1000.0  # Hz
SOFTEST = 3.0  # Hz, locked-rotor frequency at one sigma of the compliance, if the spring is unknown
NO_GAIN = 0.1  # of the average gain of one more pose: a pose with less adds nothing


def sweep_information(
    sines: Sequence[Sine],
    duration: float,
    rated_effort: float,
    load_inertia: float,
    stiffness_sigma: float,
    locked_rotor: float | None = None,
) -> Array:
    """Information (2, 2) of one sweep on [J, c], 1/(kg m^2)^2 and so on.

    `duration` of its window, s; `load_inertia` kg m^2 (kg); `stiffness_sigma` of the gravity stiffness' prior,
    N m/rad; `locked_rotor` frequency, Hz, if it is known.
    """
    frequency = np.array([sine.frequency for sine in sines])
    omega = 2 * np.pi * frequency
    gain = np.ones_like(omega) if locked_rotor is None else (1 - (frequency / locked_rotor) ** 2) ** -2
    noise = EFFORT_NOISE * rated_effort / np.sqrt(NOISE_RATE * duration / 2)
    weight = gain * np.array([sine.amplitude for sine in sines]) / noise
    seen = weight[:, None] * np.stack([omega, omega**3 * load_inertia**2], -1)
    stiffness = -weight / omega * stiffness_sigma
    along = stiffness @ seen
    return seen.T @ seen - np.outer(along, along) / (1 + stiffness @ stiffness)


class PredictedConfidence:
    """Confidence updated pose by pose. a axes are measured in each pose; p base parameters."""

    def __init__(self, rows: Array, inertia: Array, spread: Array) -> None:
        """`rows` (w, a, p) and the model's `inertia` (w, a) of the axes in the poses of the workspace; `spread` (p,):
        standard deviations of the base parameters in the nominal model.
        """
        count, axes, size = rows.shape
        self._axes, self._size, self._spread = axes, size, spread
        self._workspace = np.zeros((count * axes, size + axes))
        self._workspace[:, :size] = rows.reshape(-1, size) / inertia.reshape(-1, 1)
        softest = 1 / (np.median(inertia, axis=0) * (2 * np.pi * SOFTEST) ** 2)
        self._information = np.diag(np.concatenate([np.zeros(size), softest**-2]))

    def add(self, rows: Array, information: Array) -> None:
        """Add a pose with its rows (a, p) and the `sweep_information` (a, 2, 2) of its sweeps."""
        for axis, (row, about) in enumerate(zip(rows, information, strict=True)):
            parts = np.zeros((2, len(self._information)))
            parts[0, : self._size] = row
            parts[1, self._size + axis] = 1.0
            self._information += parts.T @ about @ parts

    def remove(self, rows: Array, information: Array) -> None:
        """Undo the `add` of a pose."""
        self.add(rows, -information)

    def percent(self) -> float:
        """Largest standard deviation of J over the workspace by the sweeps alone, percent of J; inf while rank
        deficient.
        """
        return float(self.percent_by_axis().max())

    def reaches(self, wanted: float) -> bool:
        """Whether the estimate of these sweeps will state a confidence of at most `wanted` percent."""
        return self.percent() <= wanted and bool(self.determined().all())

    def percent_by_axis(self) -> Array:
        """(a,) the same for each axis."""
        unknown = np.full(self._axes, np.inf)
        scale = np.sqrt(np.diag(self._information))
        if not scale.all():
            return unknown
        eigenvalues, vectors = np.linalg.eigh(self._information / np.outer(scale, scale))
        if eigenvalues[0] <= SINGULAR * eigenvalues[-1]:
            return unknown
        parts = (self._workspace / scale) @ (vectors / np.sqrt(eigenvalues))
        return 100 * np.sqrt(np.sum(parts**2, axis=1).reshape(-1, self._axes).max(axis=0))

    def depending(self, parameters: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(a,) axes whose J depends on some of the base `parameters` (p,) in the workspace."""
        rows = self._workspace[:, : self._size] * self._spread  # of a size that can be compared
        size = np.abs(rows).reshape(-1, self._axes, self._size).max(axis=0)
        return (size[:, parameters] > SINGULAR * size.max()).any(axis=1)

    def determined(self) -> NDArray[np.bool_]:
        """(p,) base parameters that the estimate of these sweeps will determine, if the noise is as assumed."""
        shared = self._information[: self._size, self._size :]
        own = self._information[self._size :, self._size :]
        matrix = self._information[: self._size, : self._size] - shared @ np.linalg.solve(own, shared.T)
        deviation = np.zeros(self._size)  # from the nominal model: the values do not matter, only their precision
        return Information(matrix, deviation).solve(deviation, self._spread).determined


def needed(predicted: PredictedConfidence, poses: Sequence[tuple[Array, Array]], wanted: float) -> list[int]:
    """Numbers (from 0) of the `poses` without which `predicted`, that of all of them, does not reach `wanted` percent.

    `poses`: rows and information of each, as in `add`. The last ones are tried first; `predicted` is left with the
    rest.
    """
    kept: list[int] = []
    for number in reversed(range(len(poses))):
        predicted.remove(*poses[number])
        if not predicted.reaches(wanted):
            predicted.add(*poses[number])
            kept.insert(0, number)
    return kept


def without_gain(percent: Sequence[float]) -> list[int]:
    """Numbers (from 0) of the poses that add nothing, from the confidence after each.

    Noise averaged over n + 1 instead of n poses falls by 1/(2 n); a pose with less than NO_GAIN of that adds
    nothing.
    """
    return [
        n
        for n, (before, after) in enumerate(pairwise(percent), 1)
        if np.isfinite(before) and 1 - after / before < NO_GAIN / (2 * n)
    ]
