"""Time in files: stamps of a wall clock, numbers without unit, steps that are not even."""

import re
from collections.abc import Sequence
from datetime import date

import numpy as np
from numpy.typing import NDArray

from service.model.errors import BadInput

Array = NDArray[np.float64]

_STAMP = re.compile(
    r"(?:(?:(\d{4})[-./](\d\d?)[-./](\d\d?)|(\d\d?)([./-])(\d\d?)[./-](\d{4}))[T ,]*)?"
    r"(\d\d?):(\d\d):(\d\d)(?:[.,:](\d{1,9}))?\s*([AaPp][Mm])?\s*(Z|[+-]\d\d:?\d\d)?"
)
_UNITS = (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
_SLOWEST = 20.0  # Hz: slower records do not show an inertia, so that their numbers are of a smaller unit
_UNEVEN = 0.05  # part of the steps that may be off by 20 % in an even record
_LOST = 5.0  # times the common step: values were lost


def timelike(cell: str) -> bool:
    """True for a stamp of a wall clock."""
    return _STAMP.fullmatch(cell.strip()) is not None


def seconds_of(cells: Sequence[str | None], place: str) -> Array:
    """Stamps of a wall clock in s from the first; midnight and the change to or from summer time are taken out."""
    found = np.array([_seconds(cell, place, row) for row, cell in enumerate(cells, start=1)])
    steps = np.diff(found)
    for jump in (86400.0, 3600.0):
        for sign in (1, -1):
            steps[np.abs(steps - sign * jump) < min(600.0, jump / 2)] -= sign * jump
    return np.concatenate([[0.0], np.cumsum(steps)])


def _seconds(cell: str | None, place: str, row: int) -> float:
    found = _STAMP.fullmatch((cell or "").strip())
    if found is None:
        raise BadInput(place, f"row {row} is {cell!r}, which is no time of day")
    year, month, day, first, between, second, other, hour, minute, seconds, parts, half, _ = found.groups()
    days = 0
    try:
        if year:
            days = date(int(year), int(month), int(day)).toordinal()
        elif other:
            months = (int(first), int(second)) if between == "/" and int(first) <= 12 else (int(second), int(first))
            days = date(int(other), *months).toordinal()
    except ValueError as error:
        raise BadInput(place, f"row {row} is {cell!r}: {error}") from None
    hours = int(hour) % 12 + (12 if half.lower() == "pm" else 0) if half else int(hour)
    return days * 86400.0 + hours * 3600.0 + int(minute) * 60.0 + float(f"{seconds}.{parts or 0}")


def unit_of_time(time: Array, sample_rate: float | None) -> tuple[str, float]:
    """Unit of numbers without one, and its s: that of the sample rate, else the largest of a usable rate."""
    steps = np.diff(time)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    for name, unit in _UNITS:
        rate = 1 / (step * unit)
        if sample_rate is not None and abs(rate / sample_rate - 1) < 0.1:
            return name, unit
    if sample_rate is not None:
        return "s", 1.0
    return next(((name, unit) for name, unit in _UNITS if 1 / (step * unit) >= _SLOWEST), _UNITS[0])


def spacing(time: Array) -> float:
    """s between rows, by least squares; 1 where there is none."""
    rows = np.arange(len(time)) - (len(time) - 1) / 2
    power = float(rows @ rows)
    return float(rows @ time) / power if power and np.isfinite(time).all() else 1.0


def even(time: Array, columns: dict[str, Array], place: str) -> tuple[Array, dict[str, Array], tuple[str, ...]]:
    """The record on an even grid. Stamps that are rounded or doubled take the grid's; a record of uneven rate is
    interpolated. A gap stays, for a bundle to refuse.
    """
    steps = np.diff(time)
    if len(steps) < 2 or not np.isfinite(time).all() or not (steps >= 0).all():
        return time, columns, ()
    mean = spacing(time)
    grid = time[0] + mean * np.arange(len(time))
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    off = float(np.abs(time - grid).max())
    if (steps == 0).any():
        if not mean > 0 or off > 2 * max(usual, mean):
            row = int(np.flatnonzero(steps == 0)[0])
            raise BadInput(place, f"time stands still at row {row + 2}: {time[row]:.6g} s")
        told = f"{int((steps == 0).sum())} stamps are doubled: the rows are taken as even, {1 / mean:.6g} Hz"
        return grid, columns, (told,)
    gap = steps.max() > 1.5 * usual and (np.abs(steps - usual) > 0.2 * usual).mean() <= _UNEVEN
    if gap or steps.max() > _LOST * usual or off <= 0.4 * mean:
        return time, columns, ()
    grid = time[0] + mean * np.arange(int((time[-1] - time[0]) / mean + 1e-9) + 1)
    told = f"steps of time are {steps.min():.3g} to {steps.max():.3g} s: interpolated to {1 / mean:.6g} Hz"
    return grid, {name: np.interp(grid, time, column) for name, column in columns.items()}, (told,)


def filled(column: Array) -> Array:
    """A column that has a value in each k-th row only, of a slower rate, with the rows between interpolated."""
    there = np.flatnonzero(np.isfinite(column))
    if len(there) < 3 or len(there) == len(column):
        return column
    apart = np.diff(there)
    if apart.min() < 2 or apart.min() != apart.max():
        return column
    return np.interp(np.arange(len(column)), there, column[there])
