"""Values in registers, by numbers computed by hand and by round trips."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import LimitExceeded
from drivers.modbus.codec import Format, WireType, WordOrder

HIGH, LOW = WordOrder.HIGH_FIRST, WordOrder.LOW_FIRST
RANGES: dict[WireType, tuple[int, int]] = {
    "u16": (0, 2**16 - 1),
    "i16": (-(2**15), 2**15 - 1),
    "u32": (0, 2**32 - 1),
    "i32": (-(2**31), 2**31 - 1),
}


def test_by_hand() -> None:
    assert Format("u32", HIGH).encode(0x12345678) == [0x1234, 0x5678]
    assert Format("u32", LOW).encode(0x12345678) == [0x5678, 0x1234]
    assert Format("i16", LOW).encode(-2) == [0xFFFE]
    assert Format("i32", HIGH, 0.001).encode(-1.5) == [0xFFFF, 0xFA24]  # -1500
    assert Format("f32", HIGH).encode(-2.5) == [0xC020, 0]
    assert Format("i32", HIGH, 0.001).decode([0xFFFF, 0xFA24, 0, 1500]).tolist() == [-1.5, 1.5]
    assert Format("f32", LOW).decode([0, 0xC020]).tolist() == [-2.5]


def test_rounding_is_the_callers() -> None:
    assert Format("u16", HIGH).encode(7.9, math.floor) == [7]
    assert Format("u16", HIGH).encode(7.1, math.ceil) == [8]


@pytest.mark.parametrize("order", WordOrder)
@pytest.mark.parametrize("kind", RANGES)
@given(data=st.data(), scale=st.floats(1e-9, 1e6))
def test_integers_come_back_exactly(kind: WireType, order: WordOrder, data: st.DataObject, scale: float) -> None:
    raw = data.draw(st.integers(*RANGES[kind]))
    form = Format(kind, order, scale)
    registers = form.encode(raw * scale)
    assert len(registers) == form.width
    assert form.decode(registers).tolist() == [raw * scale]


@given(
    value=st.floats(width=32, allow_nan=False, allow_infinity=False, allow_subnormal=False),
    order=st.sampled_from(WordOrder),
    scale=st.floats(1e-3, 1e3),
)
def test_floats_come_back_to_their_last_digits(value: float, order: WordOrder, scale: float) -> None:
    form = Format("f32", order, scale)
    wanted = form.clip(value)
    assert form.decode(form.encode(wanted))[0] == pytest.approx(wanted, rel=1e-6, abs=1e-38 * scale)


@given(words=st.lists(st.integers(0, 0xFFFF), min_size=2, max_size=2), kind=st.sampled_from(["u32", "i32", "f32"]))
def test_the_other_word_order_is_the_turned_registers(words: list[int], kind: WireType) -> None:
    here, turned = Format(kind, HIGH).decode(words)[0], Format(kind, LOW).decode(words[::-1])[0]
    assert here == turned or (math.isnan(here) and math.isnan(turned))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 2.0**31, -(2.0**31) - 1])
def test_what_does_not_fit_is_refused(value: float) -> None:
    with pytest.raises(LimitExceeded, match="i32"):
        Format("i32", HIGH).encode(value)


def test_clip_gives_what_fits() -> None:
    form = Format("i16", HIGH, 0.1)
    assert form.clip(1e9) == pytest.approx(3276.7)
    assert form.clip(-1e9) == pytest.approx(-3276.8)
    assert form.encode(form.clip(math.inf)) == [0x7FFF]
