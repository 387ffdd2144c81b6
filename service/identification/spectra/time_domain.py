r"""Records without lines: least squares on the DFT of each regressor, one record at a time.

    effort = J dv/dt + mu v + Fc sign(v) + offset + gravity        (rigid train)

holds at every instant, hence bin by bin for the DFTs of all its terms (`frequency_response`). Bins from 0 to 20 Hz are
a low-pass filter applied to every term alike, and the acceleration comes from integration by parts, so neither filter
nor difference quotient biases J. Back in time the K + 1 bins are 2 K + 1 equations at equal distances over the record,
with the same normal matrix (Parseval).

While an axis rests, dry friction balances any torque: each rest has a step and a slope of its own. A vertical axis has
no gravity.

Gravity of an axis that moves little is a constant to first order and replaces the offset. An axis that moves far
separates both: then the constant is kept, because it contains the dry friction of a motor that moves in one direction.

Standard deviations. White noise would give s^2 (A^T A)^-1. The residual of a rigid train is neither white nor
independent of the motion, so three estimates of theta's variance are computed, and the largest is used:

- white noise;
- stretches: the record is divided into B = `PARTS` of equal length; with theta_b the fit without stretch b,
  var theta = (B - 1)/B sum_b (theta_b - mean)^2 (delete-a-group jackknife, Shao and Wu 1989). It needs stretches longer
  than the memory of the residual, and no model of it. It has B - 1 degrees of freedom: the factor
  t_0.975(B - 1)/1.96 keeps "two standard deviations" at 95 %;
- bins: DFTs of stationary noise of any colour are independent from bin to bin, each with its own variance, for which
  the bin's residual r is used:  sum_k |(A^T A)^-1 R_k^T (1 - H_k)^-1/2 r_k|^2,  H_k its leverage (HC2, MacKinnon and
  White 1985). That holds for noise whose memory is as long as the record.

A model error that is constant over the record is in none of them. The one that every drive has is
friction that is not linear in speed. So the fit is repeated with a term v|v|; the change of J, beyond
that by noise, is added to its variance. (The friction terms with v|v| differ from those without.)
"""

from dataclasses import dataclass

import numpy as np

from service import BadInput
from service.identification.model import jackknife_factor, span
from service.identification.spectra.frequency_response import Spectrum
from service.model import Array, Complex

PARTS = 10  # stretches of the record


@dataclass(frozen=True)
class RecordFit:
    """Result of one record; SI on the joint side. `by_drag`: part of the standard deviation of J caused by friction
    that is not linear in speed.
    """

    inertia: float
    inertia_std: float
    terms: dict[str, tuple[float, float]]  # the other terms: value, std
    by_drag: float


def fit_record(spectrum: Spectrum) -> RecordFit:
    """Fit one free record with every term that its motion excites. Raises BadInput if J is then undetermined."""
    columns = _columns(spectrum)
    rows = _unrested(spectrum, np.stack(list(columns.values()), -1))
    values = _unrested(spectrum, spectrum.effort[:, None])[:, 0]
    scale = np.linalg.norm(rows, axis=0)
    scaled = rows / np.where(scale > 0, scale, 1.0)
    # of unit columns: two terms differ only by rounding
    if len(values) <= len(scale) or np.linalg.svd(scaled, compute_uv=False)[-1] < 1e-7:
        raise BadInput(
            f"sweep {spectrum.spec.id}",
            f"its motion of {spectrum.samples} samples does not separate inertia from {', '.join(list(columns)[1:])}",
        )
    solution = np.asarray(np.linalg.lstsq(scaled, values, rcond=None)[0], dtype=float)
    residual: Array = values - scaled @ solution
    inverse = np.asarray(np.linalg.inv(scaled.T @ scaled), dtype=float)
    variance, by_drag = _variance(scaled, residual, inverse), _by_drag(scaled, residual, spectrum, inverse[0])
    variance[0] += by_drag
    std = np.sqrt(variance) / scale
    result = dict(zip(columns, zip((solution / scale).tolist(), std.tolist(), strict=True), strict=True))
    inertia, inertia_std = result.pop("inertia")
    return RecordFit(
        inertia=inertia,
        inertia_std=inertia_std,
        terms=result,
        by_drag=float(np.sqrt(by_drag) / scale[0]),
    )


def _columns(spectrum: Spectrum) -> dict[str, Complex]:
    """The DFTs (b,) of the terms excited by the record's motion."""
    columns: dict[str, Complex] = {"inertia": spectrum.named("acceleration")[0], "viscous_friction": spectrum.velocity}
    for name, term in (
        ("coulomb", "coulomb_friction"),
        ("offset", "effort_offset"),
        ("gravity_torque", "gravity_torque"),
        ("gravity_stiffness", "gravity_stiffness"),
    ):
        for row in spectrum.named(name):
            columns[term] = row
    if "gravity_torque" in columns:
        constant = _in_time(columns["effort_offset"][:, None])[:, 0]
        gravity = _in_time(np.stack([columns["gravity_torque"], columns["gravity_stiffness"]], -1))
        beyond = constant - gravity @ np.linalg.lstsq(gravity, constant, rcond=None)[0]
        # a travel above 0.25 rad leaves more outside the span of its cos and sin
        if np.linalg.norm(beyond) < 0.01 * np.linalg.norm(constant):
            del columns["effort_offset"]
    return columns


def _in_time(bins: Complex) -> Array:
    """Signals (2 K + 1, p) of their DFTs (K + 1, p): low-passed, at equal distances over the record."""
    count = 2 * len(bins) - 1
    return np.fft.irfft(bins, count, axis=0) * count


def _unrested(spectrum: Spectrum, bins: Complex) -> Array:
    """`_in_time` without what a torque of any size at every rest explains: there, dry friction balances it."""
    signals, rests = _in_time(bins), spectrum.named("rest")
    if not len(rests):
        return signals
    spanned = span(_in_time(rests.T))
    return signals - spanned @ (spanned.T @ signals)


def _variance(rows: Array, residual: Array, inverse: Array) -> Array:
    """Variances (p,) by noise of a fit with rows (m, p) of unit length and its residual (m,); see the module
    docstring.
    """
    white = float(residual @ residual) / (len(residual) - rows.shape[1]) * np.diag(inverse)
    return np.maximum.reduce([white, _between_stretches(rows, residual), _between_bins(rows, residual, inverse)])


def _between_stretches(rows: Array, residual: Array) -> Array:
    """Variances (p,) by the jackknife over stretches; 0 if the record is too short to be divided.

    A fit without a stretch differs by the least-squares solution for the residual outside it. A direction shown only
    by this stretch is not changed.
    """
    if len(rows) < 4 * PARTS:  # four equations a stretch
        return np.zeros_like(rows[0])
    stretch = np.arange(len(rows)) * PARTS // len(rows)
    without = np.array(
        # directions may be missing without one stretch
        [np.linalg.lstsq(rows[stretch != b], residual[stretch != b], rcond=1e-6)[0] for b in range(PARTS)]
    )
    return np.asarray(jackknife_factor(PARTS) ** 2 * (PARTS - 1) * np.var(without, axis=0), dtype=float)


def _between_bins(rows: Array, residual: Array, inverse: Array) -> Array:
    """Variances (p,) from the residual of each bin, with `inverse` (p, p) of the normal matrix."""
    alone = 1e-6  # minimum share of a bin's equations that the other bins also determine
    left, bins = _bins(residual[:, None])[..., 0], _bins(rows)
    moments, axes = np.linalg.eigh(np.eye(2) - bins @ inverse @ np.swapaxes(bins, -1, -2))
    grown = np.where(moments > alone, 1 / np.sqrt(np.maximum(moments, alone)), 0.0)
    grown = np.einsum("kij,kj,klj,kl->ki", axes, grown, axes, left)
    influence: Array = np.einsum("kip,ki->kp", bins, grown) @ inverse
    return np.asarray(np.sum(influence**2, axis=0), dtype=float)


def _bins(signals: Array) -> Array:
    """Real and imaginary part (K + 1, 2, p) of signals (2 K + 1, p); squares add up to those of the signals."""
    transform: Complex = np.fft.rfft(signals, axis=0) / np.sqrt(len(signals))
    parts = np.stack([transform.real, transform.imag], axis=1)
    parts[1:] *= np.sqrt(2.0)
    return parts


def _by_drag(rows: Array, residual: Array, spectrum: Spectrum, inverse: Array) -> float:
    """Contribution of friction with the square of the speed to the variance of the first parameter, minus the noise of
    its estimate; `inverse` (p,) is the parameter's row of the inverse normal matrix.
    """
    drag = spectrum.named("drag")
    if not len(drag):  # spectra stored by earlier versions
        return 0.0
    column = _unrested(spectrum, drag.T)[:, 0]
    along = float(inverse @ rows.T @ column)
    beyond = column - rows @ np.linalg.lstsq(rows, column, rcond=None)[0]
    power = float(beyond @ beyond)
    # the motion does not separate it
    if power < 1e-4**2 * float(column @ column):
        return 0.0
    moved = float(beyond @ residual) / power
    by_bins = np.sum(_bins(beyond[:, None]) * _bins(residual[:, None]), axis=(1, 2))
    return max(along**2 * (moved**2 - float(by_bins @ by_bins) / power**2), 0.0)
