"""The scales of a figure: range, position of a value, ticks."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from service.report.paper.schema import Axis, Value

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_ROOM = {True: 34.0, False: 64.0}  # px needed by a tick: of a vertical, of a horizontal scale
_PAD = 0.05  # of the range, on either side of the data


@dataclass(frozen=True, slots=True)
class Scale:
    """From values to px. `low`, `high`: of the values; exponents of ten if `log`; indices of `names`."""

    low: float
    high: float
    start: float  # px of low
    end: float
    log: bool
    names: tuple[str, ...]
    ticks: tuple[tuple[float, str], ...]  # px and label

    def at(self, value: Value) -> float | None:
        """Px of a value; None if it is no number, or not above zero if `log`."""
        if isinstance(value, str):
            number = float(self.names.index(value))
        elif value is None or not math.isfinite(value) or (self.log and value <= 0):
            return None
        else:
            number = math.log10(value) if self.log else float(value)
        return self.place(number)

    def reaches(self, value: float) -> bool:
        """Whether a value is on the scale."""
        at = self.at(value)
        return at is not None and min(self.start, self.end) - 1 <= at <= max(self.start, self.end) + 1

    def place(self, number: float) -> float:
        """Px of a number between `low` and `high`."""
        return self.start + (number - self.low) / (self.high - self.low) * (self.end - self.start)


def scale_of(axis: Axis, values: Sequence[Value], from_zero: bool, start: float, end: float) -> Scale:
    """The scale of an axis of a figure's layout over `values`, from px `start` to px `end`."""
    log = axis.type == "log"
    names = tuple(dict.fromkeys(value for value in values if isinstance(value, str)))
    numbers = [float(value) for value in values if isinstance(value, (int, float)) and math.isfinite(value)]
    if axis.range is not None:
        low, high = axis.range
    elif names:
        low, high = -0.5, len(names) - 0.5
    else:
        low, high = _reach([math.log10(value) for value in numbers if value > 0] if log else numbers, from_zero)
    if axis.autorange == "reversed":
        low, high = high, low
    if low == high:
        low, high = low - 0.5, high + 0.5
    bare = Scale(low, high, start, end, log, names, ())
    room = _ROOM[start > end]  # px increase downwards
    most = axis.nticks or max(3, min(9, int(abs(end - start) / room)))
    wanted = _ticks(axis, bare, most)
    first, last = min(low, high), max(low, high)
    within = [(number, label) for number, label in wanted if first - 1e-9 <= number <= last + 1e-9]
    ticks = tuple((bare.place(number), label) for number, label in within)
    return Scale(low, high, start, end, log, names, ticks)


def round_steps(low: float, high: float, most: int) -> list[float]:
    """Round numbers from `low` to `high`, about `most` of them."""
    raw = (high - low) / max(most, 1)
    if not raw > 0:
        return [low]
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1, 2, 2.5, 5, 10) if factor * power >= 0.75 * raw)
    return [k * step for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def tick_label(value: float) -> str:
    """A number as text on a scale."""
    return f"{value + 0.0:.6g}".replace("-", "−")


def _ticks(axis: Axis, scale: Scale, most: int) -> list[tuple[float, str]]:
    low, high = min(scale.low, scale.high), max(scale.low, scale.high)
    if axis.tickvals is not None:
        labels = axis.ticktext or [tick_label(value) for value in axis.tickvals]
        return [(math.log10(v) if scale.log else v, label) for v, label in zip(axis.tickvals, labels, strict=True)]
    if scale.names:
        return [(float(k), name) for k, name in enumerate(scale.names)]
    if not scale.log:
        return [(value, tick_label(value)) for value in round_steps(low, high, most)]
    decades = range(math.floor(low), math.ceil(high) + 1)
    if high - low > 1.3:
        step = max(1, math.ceil(len(decades) / 7))
        return [(float(k), f"10{str(k).translate(_SUPERSCRIPTS)}") for k in decades[::step]]
    return [(k + math.log10(part), tick_label(part * 10.0**k)) for k in decades for part in (1, 2, 5)]


def _reach(numbers: Sequence[float], from_zero: bool) -> tuple[float, float]:
    if not numbers:
        return 0.0, 1.0
    low, high = min(numbers), max(numbers)
    room = _PAD * ((high - low) or abs(high) or 1.0)
    if from_zero:
        return (0.0 if low >= 0 else low - room), (0.0 if high <= 0 < -low else high + room)
    return low - room, high + room
