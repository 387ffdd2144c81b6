"""Register maps, `config/registers/*.yaml`: address, width and scale of each signal of a drive.

On the wire ``physical = raw * scale`` in the signal's unit; values of two registers have the word order of the map.
"""

import math
import struct
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from simulator.modbus.signals import ARRAYS, CONSTANT, ELEMENTS, PAGE_RECORD, SIGNALS
from simulator.yaml_file import parse_yaml, read_text

WordOrder = Literal["high_first", "low_first"]
WireType = Literal["u16", "i16", "u32", "i32", "f32"]

FORMATS: dict[WireType, str] = {"u16": ">H", "i16": ">h", "u32": ">I", "i32": ">i", "f32": ">f"}
_RANGES: dict[WireType, tuple[int, int]] = {
    "u16": (0, 0xFFFF),
    "i16": (-0x8000, 0x7FFF),
    "u32": (0, 0xFFFFFFFF),
    "i32": (-0x80000000, 0x7FFFFFFF),
}


class RegisterMapError(ValueError):
    """A register map cannot be used; the text names file, place and reason."""


class _Data(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Wire(_Data):
    """Format of one number in registers."""

    type: WireType
    scale: float = Field(default=1.0, gt=0)
    unit: str | None = None

    @property
    def registers(self) -> int:
        return struct.calcsize(FORMATS[self.type]) // 2

    def encode(self, value: float, order: WordOrder) -> list[int]:
        """Registers of a physical value. An integer type uses the nearest value it can hold; its lowest value means
        NaN.
        """
        raw = value / self.scale
        if self.type in _RANGES:
            low, high = _RANGES[self.type]
            raw = low if math.isnan(raw) else round(max(low, min(high, raw)))
        words = [int(word) for word in struct.unpack(f">{self.registers}H", struct.pack(FORMATS[self.type], raw))]
        return words if order == "high_first" else words[::-1]

    def decode(self, registers: Sequence[int], order: WordOrder) -> float:
        """The physical value of as many registers as there are."""
        words = registers if order == "high_first" else registers[::-1]
        (raw,) = struct.unpack(FORMATS[self.type], struct.pack(f">{len(words)}H", *words))
        return raw * self.scale


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


class Page(_Data):
    """The registers from which the trace is read."""

    address: int = Field(ge=0, le=0xFFFF)
    registers: int = Field(ge=1, le=0x10000)


class TraceMap(_Data):
    """The page and one sample in it: fields in this order, packed."""

    page: Page
    sample: Annotated[tuple[SampleField, ...], Field(min_length=1)]

    @property
    def sample_registers(self) -> int:
        return sum(field.registers for field in self.sample)

    @property
    def capacity(self) -> int:
        """Whole samples that a page holds."""
        return self.page.registers // self.sample_registers


class RegisterMap(_Data):
    """A checked map: every signal once, no overlap, units of the signals."""

    word_order: WordOrder
    max_read: int = Field(ge=2, le=125)
    signals: dict[str, MappedSignal]
    trace: TraceMap

    @model_validator(mode="after")
    def _complete(self) -> "RegisterMap":
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


def load_register_map(path: Path) -> RegisterMap:
    """Read a map. Raises RegisterMapError."""
    try:
        content = parse_yaml(read_text(path))
    except (OSError, ValueError) as error:
        raise RegisterMapError(f"{path}: cannot be read: {error}") from None
    try:
        return RegisterMap.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "map"
        raise RegisterMapError(f"{path}: {place}: {first['msg']}") from None


def _check(name: str, signal: MappedSignal) -> None:
    if signal.unit != SIGNALS[name].unit:
        raise ValueError(f"signals.{name}: unit {signal.unit} must be {SIGNALS[name].unit}")
    elements = ELEMENTS if name in ARRAYS else 1
    if signal.count != elements:
        raise ValueError(f"signals.{name}: count {signal.count} must be {elements}")
    if (signal.value is not None) != (name == CONSTANT):
        raise ValueError(f"signals.{name}: value is needed for {CONSTANT} and not allowed elsewhere")
