"""Cells of the map of a gap: one bin of one property, with numbers if it has any."""

import math
from dataclasses import dataclass

from service.model.results.part import Part


@dataclass(frozen=True, slots=True)
class Bin:
    """From `low` to `high` (None: a single value), in `unit`; `parts`: divisions of the unit, which `low` counts."""

    low: float
    high: float | None
    unit: str
    parts: int | None = None


class Cell(Part):
    """RMS of the repeatable gap in a bin, N m (N), before and after, and its significance in standard deviations."""

    dimension: str
    value: str
    rms: float
    significance: float
    rms_after: float

    @property
    def bin(self) -> Bin | None:
        """`value` in numbers: "0.1 to 0.2 rad/s", "3 Hz", "0/8 turn"; None for the name of a block or a direction."""
        first, *rest = self.value.split(" ")
        number, _, parts = first.partition("/")
        low, high = _number(number), None
        if rest[:1] == ["to"] and len(rest) > 1:
            high, rest = _number(rest[1]), rest[2:]
            if high is None:
                return None
        if low is None or not rest or (parts and not parts.isdecimal()):
            return None
        return Bin(low, high, " ".join(rest), int(parts) if parts else None)


def _number(text: str) -> float | None:
    """A number written with digits; not "nan" or "1_000", which are not used for bins."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) and "_" not in text else None
