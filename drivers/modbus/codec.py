"""Registers <-> physical values: type, word order and scale of one value or of consecutive values. Pure.

Within a register the high byte is always first. The word order applies to values of more than one register.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drivers.errors import LimitExceeded

Array = NDArray[np.float64]
Rounding = Callable[[float], int]
WireType = Literal["u16", "i16", "u32", "i32", "f32"]

_TYPES = {kind: np.dtype(f">{kind[0]}{int(kind[1:]) // 8}") for kind in ("u16", "i16", "u32", "i32", "f32")}
_ENDS: dict[str, tuple[float, float]] = {
    kind: (float(ends.min), float(ends.max))
    for kind, each in _TYPES.items()
    for ends in [np.finfo(each) if each.kind == "f" else np.iinfo(each)]
}


class WordOrder(Enum):
    """Which register of a value is first."""

    HIGH_FIRST = "high_first"
    LOW_FIRST = "low_first"

    @property
    def other(self) -> "WordOrder":
        return WordOrder.LOW_FIRST if self is WordOrder.HIGH_FIRST else WordOrder.HIGH_FIRST


@dataclass(frozen=True, slots=True)
class Format:
    """Format of one value in registers: physical = raw * scale."""

    type: WireType
    order: WordOrder
    scale: float = 1.0

    @property
    def width(self) -> int:
        """Number of registers of one value."""
        return _TYPES[self.type].itemsize // 2

    @property
    def whole(self) -> bool:
        """Whether the value is an integer on the wire."""
        return self.type != "f32"

    @property
    def least(self) -> float:
        """Lowest physical value of the type."""
        return _ENDS[self.type][0] * self.scale

    @property
    def most(self) -> float:
        """Highest physical value of the type."""
        return _ENDS[self.type][1] * self.scale

    def clip(self, value: float) -> float:
        """The nearest value that the type can hold."""
        return max(self.least, min(self.most, value))

    def encode(self, value: float, rounding: Rounding = round) -> list[int]:
        """Registers of a physical value; an integer is rounded by `rounding`. Raises LimitExceeded if it does not fit
        the type.
        """
        words = np.array([self._raw(value, rounding)], _TYPES[self.type]).view(">u2").reshape(-1, self.width)
        return [int(word) for word in self._ordered(words).ravel()]

    def decode(self, registers: Sequence[int] | NDArray[np.uint16]) -> Array:
        """(n,) physical values of n * `width` registers."""
        words = np.ascontiguousarray(self._ordered(np.asarray(registers, ">u2").reshape(-1, self.width)))
        return words.view(_TYPES[self.type]).ravel().astype(np.float64) * self.scale

    def _ordered(self, words: NDArray[np.uint16]) -> NDArray[np.uint16]:
        return words if self.order is WordOrder.HIGH_FIRST else words[:, ::-1]

    def _raw(self, value: float, rounding: Rounding) -> float:
        raw = value / self.scale
        if not (math.isfinite(raw) and self.least <= value <= self.most):
            raise LimitExceeded(f"{value:.6g} does not fit {self.type} in steps of {self.scale:g}")
        low, high = _ENDS[self.type]
        return max(low, min(high, rounding(raw) if self.whole else raw))
