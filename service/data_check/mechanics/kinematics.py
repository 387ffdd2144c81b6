r"""Velocity compared with the derivative of position; both come from one encoder.

Over the window

    position(t) = p0 + k W(t) + k D velocity(t),        W = integral of velocity

with k = 1 if the units agree. For a velocity with delay D, W(t) = way(t - D) = way(t) - D v(t), so D is the
coefficient of velocity. Nothing is differentiated, so noise is not amplified.
"""

from dataclasses import dataclass

import numpy as np

from service.data_check.record import AxisRecords, Record
from service.model.recording import Array


@dataclass(frozen=True)
class Slope:
    """Result for one record: `gain` k and its error by noise and rounding, `delay` D in s and its error."""

    record: Record
    gain: float
    gain_error: float
    delay: float | None  # None if velocity is nearly constant
    delay_error: float


def slopes(axis: AxisRecords) -> tuple[Slope, ...]:
    """The slopes of all records with enough travel."""
    found = [_slope(record) for record in axis.those(lambda record: record.travels)]
    return tuple(slope for slope in found if slope is not None)


def _slope(record: Record) -> Slope | None:
    velocity, position = record.velocity, record.position - record.position[0]
    # 20.0 steps of the position: minimum travel in a window
    if np.ptp(velocity) == 0 or np.ptp(position) <= 20.0 * record.steps["position"] or np.ptp(position) == 0:
        return None
    way = np.concatenate([[0.0], np.cumsum(velocity[1:] + velocity[:-1]) / 2]) / record.rate
    columns = np.stack([way, velocity, np.ones_like(way)], -1)
    scale = np.array([float(np.ptp(way)), float(np.ptp(velocity)), 1.0])
    unit = columns / scale
    solution = np.linalg.pinv(unit) @ position
    values = np.asarray(solution / scale, dtype=float)
    error = _errors(unit, position - unit @ solution) / scale
    steady = abs(record.spec.offset_velocity)
    rounding = record.steps["velocity"] / 2 / steady if steady else 0.0
    fastest = float(np.abs(velocity).max())
    gain = float(values[0])
    # 0.02 of the maximum: with less variation of velocity, a delay is invisible
    shows_delay = gain != 0 and float(np.std(velocity)) > 0.02 * fastest
    return Slope(
        record,
        gain,
        float(error[0]) + rounding,
        float(values[1]) / gain if shows_delay else None,
        abs(float(error[1]) / gain) if shows_delay else 0.0,
    )


def _errors(columns: Array, rest: Array) -> Array:
    """Standard errors (c,) of least squares with correlated residuals: one sample in twenty counts as independent."""
    covariance = np.linalg.pinv(columns.T @ columns) * float(rest @ rest) / max(len(rest) / 20, 1.0)
    return np.sqrt(np.diag(covariance))
