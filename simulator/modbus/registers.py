"""Signals of a register map in the drive: object of the dictionary and unit."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from simulator.drive.dictionary import ObjectDictionary
from simulator.drive.limits import INCREMENTS, speed_unit
from simulator.drive.makers import Key
from simulator.scenario import FileModel, parse_yaml, read_text

CONSTANT = "constant"
WATCHDOG = "watchdog"
OWNER = "control_owner"

PAGE_RECORD = (
    ("cycle", "<u4", None),
    ("torque", "<f4", "N m"),
    ("set_speed", "<f4", "rev/min"),
    ("speed", "<f4", "rev/min"),
    ("position", "<f8", "rev"),
    ("load_position", "<f8", "rev"),
)
"""Fields of a trace sample in 2110h:03: (signal, NumPy type, unit)."""


@dataclass(frozen=True, slots=True)
class Signal:
    """`key` is that of the first element; None for a signal that is not in the dictionary."""

    key: Key | None
    unit: str | None = None


SIGNALS: dict[str, Signal] = {
    CONSTANT: Signal(None),
    "vendor": Signal((0x1018, 1)),
    "product": Signal((0x1018, 2)),
    "revision": Signal((0x1018, 3)),
    "serial": Signal((0x1018, 4)),
    "rated_torque": Signal((0x6076, 0), "N m"),
    "controlword": Signal((0x6040, 0)),
    "statusword": Signal((0x6041, 0)),
    "error_code": Signal((0x603F, 0)),
    "mode": Signal((0x6060, 0)),
    "mode_display": Signal((0x6061, 0)),
    "position": Signal((0x6064, 0), "rev"),
    "velocity": Signal((0x606C, 0), "rev/min"),
    "torque": Signal((0x6077, 0), "permille"),
    "target_position": Signal((0x607A, 0), "rev"),
    "profile_velocity": Signal((0x6081, 0), "rev/min"),
    "profile_acceleration": Signal((0x6083, 0), "rev/min/s"),
    "profile_deceleration": Signal((0x6084, 0), "rev/min/s"),
    "quick_stop_deceleration": Signal((0x6085, 0), "rev/min/s"),
    "max_torque": Signal((0x6072, 0), "permille"),
    "max_speed": Signal((0x6080, 0), "rev/min"),
    "position_min": Signal((0x607D, 1), "rev"),
    "position_max": Signal((0x607D, 2), "rev"),
    "quick_stop_option": Signal((0x605A, 0)),
    "shutdown_option": Signal((0x605B, 0)),
    "disable_option": Signal((0x605C, 0)),
    "halt_option": Signal((0x605D, 0)),
    "fault_option": Signal((0x605E, 0)),
    "connection_loss_option": Signal((0x6007, 0)),
    WATCHDOG: Signal(None, "ms"),
    OWNER: Signal(None),
    "measuring_command": Signal((0x2100, 1)),
    "measuring_state": Signal((0x2100, 2)),
    "measuring_reason": Signal((0x2100, 3)),
    "offset_speed": Signal((0x2100, 4), "rev/min"),
    "ramp": Signal((0x2100, 5), "s"),
    "settle": Signal((0x2100, 6), "s"),
    "period": Signal((0x2100, 7), "s"),
    "periods": Signal((0x2100, 8)),
    "sines": Signal((0x2100, 9)),
    "trace_cycle": Signal((0x2100, 0x0A), "ms"),
    "samples_recorded": Signal((0x2100, 0x0B)),
    "frequency": Signal((0x2101, 1), "Hz"),
    "amplitude": Signal((0x2102, 1), "rev/min"),
    "phase": Signal((0x2103, 1), "rad"),
    "page_first": Signal((0x2110, 1)),
    "page_count": Signal((0x2110, 2)),
}

ARRAYS = ("frequency", "amplitude", "phase")


def factor(dictionary: ObjectDictionary, key: Key) -> float:
    """Unit of the object relative to that of its signal: physical = value in the dictionary * factor."""
    index = key[0]
    if index in (0x606C, 0x6080, 0x6081, 0x6083, 0x6084, 0x6085):
        return 60 / speed_unit(dictionary)
    if index in (0x6064, 0x607A, 0x607D):
        return 1 / INCREMENTS
    return 1e-3 if index == 0x6076 else 1.0


WordOrder = Literal["high_first", "low_first"]
WireType = Literal["u16", "i16", "u32", "i32", "f32"]

Words = NDArray[np.uint16]


class RegisterMapError(ValueError):
    """A register map cannot be used; the text names file, place and reason."""


class Wire(FileModel):
    """Format of one number in registers."""

    type: WireType
    scale: float = Field(default=1.0, gt=0)
    unit: str | None = None

    @property
    def kind(self) -> np.dtype[Any]:
        """As bytes on the wire."""
        return np.dtype(f">{self.type[0]}{int(self.type[1:]) // 8}")

    @property
    def registers(self) -> int:
        return self.kind.itemsize // 2

    def words(self, values: NDArray[np.float64], order: WordOrder) -> Words:
        """(n, registers) of n physical values. An integer type uses the nearest value it can hold; its lowest value
        means NaN.
        """
        with np.errstate(over="ignore"):  # then it is infinite
            raw = values / self.scale
        if self.kind.kind != "f":
            limits = np.iinfo(self.kind)
            raw = np.where(np.isnan(raw), limits.min, np.clip(np.rint(raw), limits.min, limits.max))
        words = raw.astype(self.kind)[:, None].view(">u2").astype(np.uint16)
        return words if order == "high_first" else words[:, ::-1]

    def encode(self, value: float, order: WordOrder) -> list[int]:
        """Registers of a physical value, as `words`."""
        return [int(word) for word in self.words(np.array([value], np.float64), order)[0]]

    def decode(self, registers: Sequence[int], order: WordOrder) -> float:
        """The physical value of as many registers as there are."""
        words = registers if order == "high_first" else registers[::-1]
        return float(np.array(words, ">u2").view(self.kind)[0]) * self.scale


class MappedSignal(Wire):
    """One signal with `count` consecutive elements. `value`: the value of a constant."""

    address: int = Field(ge=0, le=0xFFFF)
    access: Literal["ro", "rw"]
    count: int = Field(default=1, ge=1)
    value: int | None = None

    @property
    def size(self) -> int:
        """Registers of all elements."""
        return self.registers * self.count


class SampleField(Wire):
    """One number of a trace sample."""

    signal: str


class TracePage(FileModel):
    """The registers from which the trace is read."""

    address: int = Field(ge=0, le=0xFFFF)
    registers: int = Field(ge=1, le=0x10000)


class TraceMap(FileModel):
    """The page and one sample in it: fields in this order, packed."""

    page: TracePage
    sample: Annotated[tuple[SampleField, ...], Field(min_length=1)]

    @property
    def sample_registers(self) -> int:
        return sum(field.registers for field in self.sample)

    @property
    def capacity(self) -> int:
        """Whole samples that a page holds."""
        return self.page.registers // self.sample_registers


class RegisterLayout(FileModel):
    """A checked map: every signal once, no overlap, units of the signals."""

    word_order: WordOrder
    max_read: int = Field(ge=2, le=125)
    signals: dict[str, MappedSignal]
    trace: TraceMap

    @model_validator(mode="after")
    def _complete(self) -> "RegisterLayout":
        missing, unknown = sorted(SIGNALS.keys() - self.signals.keys()), sorted(self.signals.keys() - SIGNALS.keys())
        if missing or unknown:
            raise ValueError(f"signals: missing {missing}, unknown {unknown}")
        for name, signal in self.signals.items():
            _check(name, signal)
        sample = sorted((field.signal, field.unit or "") for field in self.trace.sample)
        expected = sorted((name, unit or "") for name, _, unit in PAGE_RECORD)
        if sample != expected:
            raise ValueError(f"trace.sample: signals and units {sample}, must be {expected}")
        if self.trace.capacity < 1:
            raise ValueError("trace.page: holds no whole sample")
        self._check_places()
        return self

    def _check_places(self) -> None:
        places = [(s.address, s.address + s.size, name) for name, s in self.signals.items()]
        page = self.trace.page
        places = sorted([*places, (page.address, page.address + page.registers, "trace.page")])
        for (_, end, name), (start, _, other) in pairwise(places):
            if start < end:
                raise ValueError(f"{other}: register {start} belongs to {name}")
        if places[-1][1] > 0x10000:
            raise ValueError(f"{places[-1][2]}: reaches beyond register 65535")


def load_register_map(path: Path) -> RegisterLayout:
    """Read a map. Raises RegisterMapError."""
    try:
        content = parse_yaml(read_text(path))
    except (OSError, ValueError) as error:
        raise RegisterMapError(f"{path}: cannot be read: {error}") from None
    try:
        return RegisterLayout.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "map"
        raise RegisterMapError(f"{path}: {place}: {first['msg']}") from None


def _check(name: str, signal: MappedSignal) -> None:
    if signal.unit != SIGNALS[name].unit:
        raise ValueError(f"signals.{name}: unit {signal.unit} must be {SIGNALS[name].unit}")
    elements = 16 if name in ARRAYS else 1  # Number of elements of the signals in `ARRAYS`.
    if signal.count != elements:
        raise ValueError(f"signals.{name}: count {signal.count} must be {elements}")
    if (signal.value is not None) != (name == CONSTANT):
        raise ValueError(f"signals.{name}: value is needed for {CONSTANT} and not allowed elsewhere")


_RECORD = np.dtype([(name, layout) for name, layout, _ in PAGE_RECORD])


def page_registers(page: bytes, trace: TraceMap, order: WordOrder, first: int, count: int) -> list[int]:
    """Registers `first` to `first + count - 1` of the page; 0 if there is no sample."""
    width = trace.sample_registers
    sample, skipped = divmod(first, width)
    last = min(-(-(first + count) // width), trace.capacity)
    records = np.frombuffer(page, _RECORD)[sample:last]
    columns = [field.words(records[field.signal].astype(np.float64), order) for field in trace.sample]
    words = np.hstack(columns).ravel()
    registers = [int(word) for word in words[skipped : skipped + count]]
    return registers + [0] * (count - len(registers))
