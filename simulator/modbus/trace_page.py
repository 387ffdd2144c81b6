"""Trace samples of the drive (2110h:03) in the registers of the page."""

import numpy as np
from numpy.typing import NDArray

from simulator.modbus.register_map import SampleField, TraceMap, WordOrder
from simulator.modbus.signals import PAGE_RECORD

Words = NDArray[np.uint16]

_RECORD = np.dtype([(name, layout) for name, layout, _ in PAGE_RECORD])


def page_registers(page: bytes, trace: TraceMap, order: WordOrder, first: int, count: int) -> list[int]:
    """Registers `first` to `first + count - 1` of the page; 0 if there is no sample."""
    width = trace.sample_registers
    sample, skipped = divmod(first, width)
    last = min(-(-(first + count) // width), trace.capacity)
    records = np.frombuffer(page, _RECORD)[sample:last]
    words = np.hstack([_words(records[field.signal], field, order) for field in trace.sample]).ravel()
    registers = [int(word) for word in words[skipped : skipped + count]]
    return registers + [0] * (count - len(registers))


def _words(values: NDArray[np.float64], field: SampleField, order: WordOrder) -> Words:
    """(n, registers) of one field. An integer type uses the nearest value it can hold; its lowest value means NaN."""
    raw = values.astype(np.float64) / field.scale
    if field.type == "f32":
        numbers = raw.astype(">f4")
    else:
        kind = np.dtype(f">{field.type[0]}{int(field.type[1:]) // 8}")
        limits = np.iinfo(kind)
        numbers = np.where(np.isnan(raw), limits.min, np.clip(np.rint(raw), limits.min, limits.max)).astype(kind)
    words = numbers[:, None].view(">u2").astype(np.uint16)
    return words if order == "high_first" else words[:, ::-1]
