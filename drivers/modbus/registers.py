"""The register map of a type of drive (docs/how-to/connect-a-modbus-drive.md): address and format of each signal.

Within a register the high byte is always first. The word order applies to values of more than one register.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from pathlib import Path
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from drivers.bounded_yaml import read_mapping
from drivers.cia402.profile import Frozen, parse
from drivers.errors import BadProfile, LimitExceeded
from drivers.ports import Array

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
        """Registers of a physical value, rounded by `rounding` if whole. LimitExceeded if it does not fit the type."""
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


MAX_WRITE = 123  # registers per request, Modbus application protocol V1.1b3, 6.12

# Unit by signal; None for an integer without unit and scale.
NEEDED: dict[str, str | None] = {
    "constant": None,
    "vendor": None,
    "product": None,
    "revision": None,
    "serial": None,
    "rated_torque": "N m",
    "controlword": None,
    "statusword": None,
    "error_code": None,
    "mode": None,
    "mode_display": None,
    "position": "rev",
    "velocity": "rev/min",
    "torque": "permille",
    "target_position": "rev",
    "profile_velocity": "rev/min",
    "profile_acceleration": "rev/min/s",
    "profile_deceleration": "rev/min/s",
    "quick_stop_deceleration": "rev/min/s",
}
OPTIONAL: dict[str, str | None] = {
    "max_torque": "permille",
    "max_speed": "rev/min",
    "position_min": "rev",
    "position_max": "rev",
    "quick_stop_option": None,
    "shutdown_option": None,
    "disable_option": None,
    "halt_option": None,
    "fault_option": None,
    "connection_loss_option": None,
    "watchdog": "ms",
    "control_owner": None,
}
MEASURING: dict[str, str | None] = {  # a map has all of them and a trace, or none
    "measuring_command": None,
    "measuring_state": None,
    "measuring_reason": None,
    "offset_speed": "rev/min",
    "ramp": "s",
    "settle": "s",
    "period": "s",
    "periods": None,
    "sines": None,
    "trace_cycle": "ms",
    "samples_recorded": None,
    "frequency": "Hz",
    "amplitude": "rev/min",
    "phase": "rad",
    "page_first": None,
    "page_count": None,
}
SAMPLE: dict[str, str | None] = {
    "cycle": None,
    "torque": "N m",
    "set_speed": "rev/min",
    "speed": "rev/min",
    "position": "rev",
    "load_position": "rev",
}
READ_ONLY = {
    "constant", "vendor", "product", "revision", "serial", "rated_torque", "statusword", "error_code", "mode_display",
    "position", "velocity", "torque", "measuring_state", "measuring_reason", "samples_recorded",
}  # fmt: skip
ARRAYS = {"frequency", "amplitude", "phase"}
_SIGNALS = NEEDED | OPTIONAL | MEASURING


class _Wire(Frozen):
    type: WireType
    scale: float = Field(default=1.0, gt=0)  # physical = raw * scale
    unit: str | None = None


class _SignalPlace(_Wire):
    address: int = Field(ge=0, le=0xFFFF)
    access: Literal["ro", "rw"]
    count: int = Field(default=1, ge=1, le=16)
    value: int | None = None


class _Field(_Wire):
    signal: str


class _Page(Frozen):
    address: int = Field(ge=0, le=0xFFFF)
    registers: int = Field(ge=1, le=0x10000)


class _Trace(Frozen):
    page: _Page
    sample: tuple[_Field, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _complete(self) -> "_Trace":
        names = [field.signal for field in self.sample]
        if len(set(names)) < len(names) or set(names) | {"load_position"} != set(SAMPLE):
            raise ValueError(f"sample: signals {names} must be {list(SAMPLE)}, the last only if there is one")
        for field in self.sample:
            _check_unit(f"sample {field.signal}", field, SAMPLE[field.signal])
        return self


class _Map(Frozen):
    word_order: WordOrder
    max_read: int = Field(default=125, ge=2, le=125)  # registers per request
    signals: dict[str, _SignalPlace]
    trace: _Trace | None = None

    @model_validator(mode="after")
    def _complete(self) -> "_Map":
        missing, unknown = sorted(NEEDED.keys() - self.signals), sorted(self.signals.keys() - _SIGNALS)
        if missing or unknown:
            raise ValueError(f"signals: missing {missing}, unknown {unknown}")
        measuring = set(MEASURING) & set(self.signals)
        if measuring and len(measuring) < len(MEASURING):
            raise ValueError(f"signals: a measuring function needs {sorted(MEASURING.keys() - measuring)} as well")
        if bool(measuring) is not (self.trace is not None):
            raise ValueError("trace: needed with a measuring function, not allowed without one")
        for name, place in self.signals.items():
            self._check(name, place)
        self._check_places()
        return self

    def _check(self, name: str, place: _SignalPlace) -> None:
        _check_unit(f"signals.{name}", place, _SIGNALS[name])
        if (place.access == "ro") is not (name in READ_ONLY):
            raise ValueError(f"signals.{name}: access must be {'ro' if name in READ_ONLY else 'rw'}")
        if place.count > 1 and name not in ARRAYS:
            raise ValueError(f"signals.{name}: count must be 1")
        if (place.value is not None) is not (name == "constant"):
            raise ValueError(f"signals.{name}: value is needed for the constant and not allowed elsewhere")
        if name == "constant" and not _tells_the_word_order(place, self.word_order):
            raise ValueError("signals.constant: must be u32 or i32, hold its value, and have two different words")

    def _check_places(self) -> None:
        places = [(p.address, p.address + p.count * _width(p), name) for name, p in self.signals.items()]
        if self.trace is not None:
            page, width = self.trace.page, sum(_width(field) for field in self.trace.sample)
            places.append((page.address, page.address + page.registers, "trace.page"))
            if width > min(page.registers, self.max_read):
                raise ValueError(f"trace.sample: {width} registers do not fit a page, or a request (max_read)")
        places.sort()
        for (_, end, name), (start, _, other) in pairwise(places):
            if start < end:
                raise ValueError(f"{other}: register {start:04X}h belongs to {name}")
        if places[-1][1] > 0x10000:
            raise ValueError(f"{places[-1][2]}: reaches beyond register FFFFh")


@dataclass(frozen=True, slots=True)
class RegisterSignal:
    """One signal of the map."""

    name: str
    address: int
    format: Format
    count: int = 1

    def __str__(self) -> str:
        return f"{self.name} ({self.address:04X}h)"

    @property
    def end(self) -> int:
        """The first register after it."""
        return self.address + self.count * self.format.width

    def elements(self) -> list["RegisterSignal"]:
        """Each value as a signal of its own."""
        width = self.format.width
        return [
            RegisterSignal(f"{self.name} {number + 1}", self.address + number * width, self.format)
            for number in range(self.count)
        ]


@dataclass(frozen=True, slots=True)
class TraceLayout:
    """The page buffer and the layout of one sample."""

    address: int
    registers: int
    sample: tuple[tuple[str, Format], ...]

    @property
    def width(self) -> int:
        """Number of registers of one sample."""
        return sum(each.width for _, each in self.sample)


@dataclass(frozen=True, slots=True)
class RegisterMap:
    """A checked map."""

    max_read: int
    signals: Mapping[str, RegisterSignal]
    constant: int
    trace: TraceLayout | None


def spans(signals: Iterable[RegisterSignal], most: int) -> list[list[RegisterSignal]]:
    """The signals by address, grouped if they are adjacent and fit one request of `most` registers."""
    joined: list[list[RegisterSignal]] = []
    for signal in sorted(signals, key=lambda signal: signal.address):
        last = joined[-1] if joined else None
        if last and signal.address == last[-1].end and signal.end - last[0].address <= most:
            last.append(signal)
        else:
            joined.append([signal])
    return joined


def load_registers(path: Path) -> RegisterMap:
    """Read a register map. BadProfile names the file, the place and the reason."""
    try:
        return parse_registers(read_mapping(path, "signals"))
    except BadProfile as error:
        raise BadProfile(f"registers: {path}: {error}") from None


def parse_registers(content: object) -> RegisterMap:
    """Check a register map. BadProfile names the first wrong place and the reason."""
    if not isinstance(content, Mapping):
        raise BadProfile("must be a mapping with the key 'signals'")
    parsed = parse(_Map, cast("Mapping[str, object]", content))
    order = parsed.word_order
    trace = None
    if parsed.trace is not None:
        page, sample = parsed.trace.page, parsed.trace.sample
        layout = tuple((field.signal, Format(field.type, order, field.scale)) for field in sample)
        trace = TraceLayout(page.address, page.registers, layout)
    return RegisterMap(
        max_read=parsed.max_read,
        signals={
            name: RegisterSignal(name, place.address, Format(place.type, order, place.scale), place.count)
            for name, place in parsed.signals.items()
        },
        constant=parsed.signals["constant"].value or 0,
        trace=trace,
    )


def _check_unit(what: str, wire: _Wire, unit: str | None) -> None:
    if wire.unit != unit:
        raise ValueError(f"{what}: unit {wire.unit} must be {unit}")
    if unit is None and (wire.type == "f32" or wire.scale != 1):
        raise ValueError(f"{what}: must be a whole number without scale")


def _tells_the_word_order(place: _SignalPlace, order: WordOrder) -> bool:
    if place.type not in ("u32", "i32") or place.value is None:
        return False
    here = Format(place.type, order)
    if not here.least <= place.value <= here.most:
        return False
    high, low = here.encode(place.value)
    return high != low


def _width(wire: _Wire) -> int:
    return Format(wire.type, WordOrder.HIGH_FIRST).width
