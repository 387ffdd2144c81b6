r"""The frequency response of an axis' drive train, with the injected torque as reference.

While the axis moves slowly, the drive adds a periodic torque r inside its speed loop. Effort u and velocity v
respond to r, but also to torque ripple and other disturbances of the axis, and the loop feeds that back into both:
u/v, or the H1 estimate sum(u v*) / sum(|v|^2), then lies between the impedance and minus the controller's gain. With r
as reference (Pintelon and Schoukens, System RobotEstimate, 2012, sec. 2.6.2 and 2.7)

    Z = Gamma/Omega = E[u/r] / E[v/r]

everything uncorrelated with r averages out. The scatter of the averaged parts is the covariance C of u/r and v/r, and

    var Z = (C_uu + |Z|^2 C_vv - 2 Re(Z* C_uv)) / |E[v/r]|^2.

Runs are averaged, or single periods if there are few runs. In a run of P periods the lines of r are every P-th bin; the
offset is chosen so that no ripple falls on one (`excitation.ripple_free_offset`). That is not sufficient: torque that
depends on the position acts on a soft loop like friction that decreases with speed, about 100 N m s/rad of 200, and as
the speed of the axis is never exact, the ends of the window differ. On the five bins n around each line of
the whole window (local polynomial method, loc. cit. sec. 7.2)

    u_n = (Z + Z' n) v_n + e + sum theta_j x_jn,    x = DFT of cos and sin of known orders times the motor angle,

with theta common to all lines, Z, Z' and the window's ends e their own. Least squares give theta and e. They are
subtracted from the effort; Z of this fit is the biased quotient and is not used.

Gravity that changes along the path is a ramp in the effort that would leak onto every line: from each signal the
straight line through the means of its periods is subtracted, which does not change periodic signals.

A drive without torque injection is measured by sines of its speed set-point, a few lines per sweep: `stepped_response`
computes the same from them, with the commanded sine as r.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service import BadInput
from service.identification.spectra.frequency_response import (
    Band,
    Spectrum,
    check_numbers,
    from_pairs,
    pairs,
    ripple_orders,
    window,
)
from service.model import Array, Axis, Complex, Indices, Robot, Sweep, SweepSpec
from service.model.results.spectrum import NoiseDocument

NEAR = 2  # bins on either side of a line from which ripple is found


@dataclass(frozen=True)
class NoiseSpectrum:
    """Data of one noise run: DFTs of each of its p periods at the b excited lines; SI on the joint side."""

    spec: SweepSpec
    frequency: Array  # (b,) Hz
    reference: Complex  # (p, b) injected torque
    effort: Complex  # (p, b)
    velocity: Complex  # (p, b)

    def to_document(self) -> NoiseDocument:
        """For a file; floats are stored without loss."""
        return {
            "spec": self.spec.model_dump(mode="json"),
            "frequency": self.frequency.tolist(),
            "reference": [pairs(row) for row in self.reference],
            "effort": [pairs(row) for row in self.effort],
            "velocity": [pairs(row) for row in self.velocity],
        }

    @classmethod
    def from_document(cls, document: NoiseDocument) -> "NoiseSpectrum":
        """The inverse of `to_document`."""
        return cls(
            SweepSpec.model_validate(document["spec"]),
            np.array(document["frequency"]),
            *(
                np.array([from_pairs(row) for row in rows])
                for rows in (document["reference"], document["effort"], document["velocity"])
            ),
        )


@dataclass(frozen=True)
class FrequencyResponse:
    """Averaged response at b lines. `covariance` (b, 2, 2) is that of the means of (effort, velocity), line by line."""

    frequency: Array  # (b,) Hz, ascending
    effort: Complex  # (b,) per unit of the reference
    velocity: Complex  # (b,)
    covariance: Complex  # E[x x^H]
    coherence: Array  # (b,) of reference and velocity in one of the averaged parts, 0 ... 1

    @property
    def impedance(self) -> Complex:
        """Z = effort/velocity (b,), N m s/rad (N s/m)."""
        return self.effort / self.velocity

    def variance(self, impedance: Complex) -> Array:
        """E|error of Z|^2 (b,) if the true impedance is `impedance` (b,).

        The part that neither responds to the reference nor fits the impedance is noise of the effort, similar on
        neighbouring lines: it is averaged over them.
        """
        own = self.covariance[:, 0, 0].real + np.abs(impedance) ** 2 * self.covariance[:, 1, 1].real
        shared = 2 * (impedance.conj() * self.covariance[:, 0, 1]).real
        return _smooth(np.maximum(own - shared, 0.0)) / np.abs(self.velocity) ** 2


def has_reference(sweep: Sweep) -> bool:
    """Whether it is a noise run of whole periods with recorded injected torque."""
    spec = sweep.spec
    return spec.excitation == "noise" and spec.periods is not None and sweep.recording.excitation_effort is not None


def noise_spectrum(robot: Robot, sweep: Sweep) -> NoiseSpectrum:
    """The spectrum of one noise run of an axis of `robot`; BadInput without injected torque or whole periods, or
    where a sample is not a finite number."""
    spec, record = sweep.spec, robot.without_counterbalance(sweep).recording
    check_numbers(spec, record)
    place = f"sweep {spec.id}"
    if record.excitation_effort is None:
        raise BadInput(place, "has no column excitation_effort, the reference of its frequency response")
    first, count = window(spec, record.time)
    periods = spec.periods or 1
    if count % periods:
        raise BadInput(place, f"a period of {spec.period} s is not a whole number of samples at {spec.sample_rate} Hz")
    length = count // periods
    part = slice(first, first + count)
    reference, effort, velocity = (
        _without_drift(column[part], periods) for column in (record.excitation_effort, record.effort, record.velocity)
    )
    strength = np.abs(np.fft.rfft(reference)[::periods])[: int(Band.below_nyquist * length) + 1]
    # weaker lines count as not excited
    lines = np.flatnonzero(strength > 0.1 * strength[1:].max(initial=0.0))
    lines = lines[lines > 0]
    if len(lines) < 2:
        raise BadInput(place, "its injected torque has no lines")
    waves = np.array([_without_drift(wave, periods) for wave in _ripple(robot.axis(spec.axis), record.position[part])])
    factors, ends = _ripple_and_ends(effort, velocity, waves.reshape(-1, count), lines * periods)
    if len(waves):
        effort = effort - factors @ waves
    return NoiseSpectrum(
        spec,
        np.asarray(lines * (spec.sample_rate / length), dtype=np.float64),
        reference=_period_spectra(reference, periods)[:, lines],
        effort=_period_spectra(effort, periods)[:, lines] - ends,
        velocity=_period_spectra(velocity, periods)[:, lines],
    )


def noise_response(runs: Sequence[NoiseSpectrum]) -> FrequencyResponse:
    """The mean over runs of one axis in one pose. BadInput if their lines differ, or if there is no scatter."""
    for run in runs:
        if not np.array_equal(run.frequency, runs[0].frequency):
            raise BadInput(f"sweep {run.spec.id}", f"has other lines than sweep {runs[0].spec.id} of the same pose")
    if len(runs) >= 3:  # enough to average runs instead of periods
        parts = np.array([_answers(run.reference.mean(0), run.effort.mean(0), run.velocity.mean(0)) for run in runs])
    else:
        parts = np.concatenate(
            [_answers(run.reference, run.effort, run.velocity).transpose(1, 0, 2) for run in runs], axis=0
        )
    count = len(parts)
    if count < 2:
        raise BadInput(f"sweep {runs[0].spec.id}", "one period alone does not determine its noise")
    mean = parts.mean(axis=0)
    error = parts - mean
    scatter = np.einsum("nib,njb->bij", error, error.conj()) / (count - 1)
    return FrequencyResponse(
        runs[0].frequency, mean[0], mean[1], scatter / count, _coherence(mean[1], scatter[:, 1, 1].real)
    )


def stepped_response(sweeps: Sequence[Spectrum]) -> FrequencyResponse:
    """The same from sweeps with few lines each, any number per line; their noise is that of the bins between."""
    found: dict[float, list[tuple[complex, complex, float]]] = {}
    for sweep in sweeps:
        effort, noise = _without_gravity_and_ripple(sweep)
        phasors = {
            sine.frequency: sine.amplitude / 2 * np.exp(1j * (sine.phase - np.pi / 2)) for sine in sweep.spec.sines
        }
        for line in np.flatnonzero(sweep.line):
            frequency = min(phasors, key=lambda each, at=float(sweep.frequency[line]): abs(each - at))
            phasor = phasors[frequency]
            found.setdefault(frequency, []).append(
                (complex(effort[line] / phasor), complex(sweep.velocity[line] / phasor), noise / abs(phasor) ** 2)
            )
    frequency = np.array(sorted(found))
    count = np.array([len(found[each]) for each in sorted(found)])
    mean = np.array([np.mean(found[each], axis=0) for each in sorted(found)], dtype=np.complex128)
    covariance = np.zeros((len(frequency), 2, 2), dtype=np.complex128)
    covariance[:, 0, 0] = mean[:, 2] / count
    effort, velocity = mean[:, 0], mean[:, 1]
    scatter = mean[:, 2].real * np.abs(velocity / effort) ** 2  # treated as noise of the velocity
    return FrequencyResponse(frequency, effort, velocity, covariance, _coherence(velocity, scatter))


def _coherence(mean: Complex, scatter: Array) -> Array:
    power = np.abs(mean) ** 2
    return power / (power + scatter)


def _without_drift(signal: Array, periods: int) -> Array:
    """A signal (n,) minus the straight line through the means of its periods."""
    if periods == 1:
        return signal
    number = np.arange(periods) - (periods - 1) / 2
    slope = signal.reshape(periods, -1).mean(axis=1) @ number / (number @ number)
    return signal - slope * np.linspace(0, periods, len(signal), endpoint=False)


def _period_spectra(signal: Array, periods: int) -> Complex:
    """DFTs (p, bins) of each period of a signal (n,)."""
    return np.fft.rfft(signal.reshape(periods, -1)) * periods / len(signal)


def _ripple(axis: Axis, position: Array) -> list[Array]:
    """cos and sin (n,) of each order of the motor angle."""
    angles = [order * axis.gear_ratio * position for order in ripple_orders(axis)]
    return [wave for angle in angles for wave in (np.cos(angle), np.sin(angle))]


def _ripple_and_ends(effort: Array, velocity: Array, waves: Array, lines: Indices) -> tuple[Array, Complex]:
    """theta (r,) of the waves (r, n) and e (b,) at `lines` (b,) of the whole window; see the module's header."""
    near = np.arange(-NEAR, NEAR + 1)
    last = len(effort) // 2
    bins = np.clip(lines, NEAR, last - NEAR)[:, None] + near
    v, u, x = (np.fft.rfft(signal)[..., bins] / len(effort) for signal in (velocity, effort, waves))
    scale = np.abs(v).max(axis=1, keepdims=True)
    basis = np.stack([v / scale, near * v / scale, np.ones_like(v)], axis=-1)
    solver = np.linalg.pinv(basis)

    def beyond(signals: Complex) -> Complex:
        inside = np.einsum("bin,...bn->...bi", solver, signals)
        return signals - np.einsum("bni,...bi->...bn", basis, inside)

    rows, values = beyond(x).reshape(len(waves), -1), beyond(u).ravel()
    factors = np.linalg.lstsq(np.hstack([rows.real, rows.imag]).T, np.concatenate([values.real, values.imag]))[0]
    ends = np.einsum("bn,bn->b", solver[:, 2], u - np.tensordot(factors, x, axes=1))
    return np.asarray(factors, dtype=np.float64), ends


def _answers(reference: Complex, effort: Complex, velocity: Complex) -> Complex:
    """(2, ...) effort and velocity per unit of the reference."""
    return np.stack([effort / reference, velocity / reference])


def _smooth(values: Array) -> Array:
    """Mean of each line and its neighbours, (b,)."""
    neighbours = 3  # lines on either side over which noise is averaged
    total = np.concatenate([[0.0], np.cumsum(values)])
    line = np.arange(len(values))
    first, last = np.maximum(line - neighbours, 0), np.minimum(line + neighbours + 1, len(values))
    return (total[last] - total[first]) / (last - first)


def _without_gravity_and_ripple(sweep: Spectrum) -> tuple[Complex, float]:
    """Effort (b,) minus the part that changes along the path, and E|noise|^2 of one of its bins.

    Both come from the bins between the lines, where the axis is assumed to have the mean impedance of its lines.
    """
    s = 2j * np.pi * sweep.frequency
    between = ~sweep.line
    z = sweep.effort[sweep.line] / sweep.velocity[sweep.line]
    omega = s[sweep.line].imag
    rigid = s * float(z.imag @ omega / (omega @ omega)) + float(z.real.mean())
    stiffness = sweep.named("gravity_stiffness") - sweep.velocity / s
    signals = np.concatenate([sweep.named("gravity_torque"), stiffness, sweep.named("ripple")], axis=0)
    left = (sweep.effort - rigid * sweep.velocity)[between]
    rows = np.vstack([signals[:, between].T.real, signals[:, between].T.imag])
    values = np.concatenate([left.real, left.imag])
    if len(values) <= rows.shape[1]:
        raise BadInput(f"sweep {sweep.spec.id}", "has too few bins between its lines to determine its noise")
    factors = np.linalg.lstsq(rows, values)[0]
    rest = values - rows @ factors
    noise = 2 * float(rest @ rest) / (len(values) - rows.shape[1])
    return sweep.effort - factors @ signals, noise
