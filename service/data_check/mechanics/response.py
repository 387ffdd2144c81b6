r"""Frequency response of effort at the lines: apparent inertia of each record, for comparison with CAD.

Z = Effort/Velocity at each commanded line over complete periods; for a rigid axis  Z = i w J + mu. With elasticity,
Im Z / w increases towards the locked-rotor frequency and is negative above; gravity decreases it by 1/w^2. Therefore
the inertia is taken from the lowest line, if that is low enough. Bins between the lines give the noise. The ripple of
known orders is subtracted first, because it may coincide with a line.
Records without lines are fitted as the identification does (`time_domain`).
"""

from dataclasses import dataclass

import numpy as np

from service.data_check.mechanics.motion import Commanded
from service.data_check.record import AxisRecords, Record
from service.identification.spectra.frequency_response import Complex, ripple_orders, spectrum
from service.identification.spectra.time_domain import fit_record
from service.model.errors import BadInput
from service.model.recording import Array


@dataclass(frozen=True)
class Response:
    """Result of one record: apparent inertia, resistance (apparent viscous friction), errors; SI units, joint side.

    `frequency`, `impedance`, `error` (l,) at its lines, empty without lines.
    """

    record: Record
    inertia: float
    inertia_error: float
    resistance: float
    resistance_error: float
    frequency: Array
    impedance: Complex
    error: Array


def responses(axis: AxisRecords, followed: dict[str, Commanded]) -> tuple[Response, ...]:
    """The responses of all records that determine inertia; velocity is converted to the commanded unit and sign."""
    found: list[Response] = []
    for record in axis.those(lambda record: record.alone and record.spec.shows_inertia):
        one = _at_lines(axis, record, followed.get(record.id)) if record.spec.periodic else _free(axis, record)
        if one is not None:
            found.append(one)
    return tuple(found)


def _at_lines(axis: AxisRecords, record: Record, followed: Commanded | None) -> Response | None:
    spec, count = record.spec, record.count
    step = record.rate / count
    frequency = np.sort([sine.frequency for sine in spec.sines])
    lines = np.round(frequency / step).astype(int)
    # Hz: below it, with locked-rotor frequencies of 5 Hz and more, a line shows the inertia, not the spring
    if frequency[0] > 4.5 or np.any(np.abs(frequency / step - lines) > 0.01) or lines[-1] >= count // 2:
        return None
    transform: Complex = np.fft.rfft(_without_ripple(axis, record, frequency)) / count
    velocity = np.fft.rfft(record.velocity)[lines] / count
    if followed is not None and followed.gain:
        velocity = velocity / followed.gain
    if not np.all(np.abs(velocity) > 0):
        return None
    # Hz above the last line: upper end of the noise band
    bins = np.arange(1, min(int(lines[-1]) + round(3.0 / step), count // 2))
    between = bins[~np.isin(bins, lines)]
    noise = float(np.sqrt(np.mean(np.abs(transform[between]) ** 2))) if between.size else 0.0
    impedance, error = transform[lines] / velocity, noise / np.abs(velocity)
    omega = 2 * np.pi * frequency
    return Response(
        record,
        float(impedance[0].imag / omega[0]),
        float(error[0] / omega[0]),
        float(impedance[0].real),
        float(error[0]),
        frequency,
        impedance,
        error,
    )


def _without_ripple(axis: AxisRecords, record: Record, frequency: Array) -> Array:
    """Effort (n,) without trend and without the ripple of known orders, as far as these differ from the lines."""
    count = record.count
    ramp = np.linspace(-0.5, 0.5, count)
    angles = [2 * np.pi * line * np.arange(count) / record.rate for line in frequency]
    turned = axis.axis.gear_ratio * (record.position - record.position[0])
    ripples = [order * turned for order in ripple_orders(axis.axis)]
    lines = np.array([wave(angle) for angle in angles for wave in (np.cos, np.sin)])
    others = np.array([np.ones(count), ramp, *(wave(angle) for angle in ripples for wave in (np.cos, np.sin))])
    columns = np.concatenate([others, lines]).T
    solution = np.asarray(np.linalg.lstsq(columns, record.effort, rcond=1e-6)[0], dtype=float)
    return record.effort - solution[: len(others)] @ others


def _free(axis: AxisRecords, record: Record) -> Response | None:
    try:
        fit = fit_record(spectrum(axis.robot, record.sweep))
    except BadInput:  # too short, or the motion does not determine inertia
        return None
    empty = np.zeros(0)
    resistance, error = fit.terms["viscous_friction"]
    return Response(record, fit.inertia, fit.inertia_std, resistance, error, empty, empty.astype(complex), empty)
