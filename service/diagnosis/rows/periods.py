"""A record that repeats within itself: one sweep is cut into its periods, which then count as repeats."""

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from service import BadInput
from service.diagnosis.rows.signals import is_evidence
from service.model import Recording, Sweep


def in_periods(joint: str, sweeps: Sequence[Sweep]) -> list[Sweep]:
    """The sweeps of an axis that are evidence; a single sweep that repeats its motion is cut into periods.

    BadInput if it is shorter than its period, or if no sweep has velocity, or effort.
    """
    own = [sweep for sweep in sweeps if sweep.spec.axis == joint and is_evidence(sweep.spec)]
    for column in ("velocity", "effort"):
        if own and not any(np.any(getattr(sweep.recording, column)) for sweep in own):
            raise BadInput(joint, f"{column} is 0 in every sample of its sweeps")
    if len(own) != 1 or own[0].spec.excitation != "trajectory":
        return own
    samples = _period(own[0])
    if samples == 0:
        return own
    count = len(own[0].recording.time) // samples
    if count == 0:
        spec, length = own[0].spec, len(own[0].recording.time) / own[0].spec.sample_rate
        raise BadInput(
            f"sweep {spec.id}", f"its period of {spec.period:g} s is longer than its {length:.2f} s of samples"
        )
    return [_cut(own[0], samples, number) for number in range(count)]


def _period(sweep: Sweep) -> int:
    """Samples per period: from the spec, else the shift with the largest autocorrelation of velocity; 0: none."""
    if sweep.spec.period is not None:
        return round(sweep.spec.period * sweep.spec.sample_rate)
    velocity = sweep.recording.velocity
    count = len(velocity)
    size = 1 << int(np.ceil(np.log2(2 * count)))
    transform = np.fft.rfft(velocity, size)
    products = np.fft.irfft(np.abs(transform) ** 2, size)[:count]
    energy = np.concatenate([[0.0], np.cumsum(velocity**2)])
    shifts = np.arange(count)
    norm = np.sqrt(energy[count - shifts] * (energy[count] - energy[shifts]))
    alike = products / np.maximum(norm, 1e-300)
    # 1.0 s
    first, last = round(1.0 * sweep.spec.sample_rate), count // 2
    if last <= first:
        return 0
    best = first + int(np.argmax(alike[first:last]))
    # 0.98 correlation of the velocity with itself one period later
    return best if alike[best] > 0.98 else 0


def _cut(sweep: Sweep, samples: int, number: int) -> Sweep:
    at = slice(number * samples, (number + 1) * samples)
    columns = {
        field.name: None if (values := getattr(sweep.recording, field.name)) is None else values[at]
        for field in fields(Recording)
    }
    recording = replace(sweep.recording, **columns)
    spec = sweep.spec.model_copy(
        update={"repeat": number, "started_at": sweep.spec.started_at + number * samples / sweep.spec.sample_rate}
    )
    return Sweep(spec, replace(recording, time=recording.time - recording.time[0]))
