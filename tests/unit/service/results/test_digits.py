"""Digits of a value and its standard deviation, and where they stand: one rule for report and sheet."""

import pytest
from hypothesis import given, strategies as st

from service.formats.export.sheets.text import as_markdown
from service.model.results.part import with_std
from service.model.results.sheet import Sheet
from tests.stored.documents import stored


@pytest.mark.parametrize(
    ("value", "std", "shown"),
    [
        (253.23, 9.5, ("253.2", "9.5")),
        (61.25, 0.5, ("61.25", "0.50")),
        (9.996, 0.0996, ("10.00", "0.10")),
        (12347.0, 123.0, ("12350", "120")),
        (-12.6, 99.6, ("-10", "100")),
        (1e-9, 1.0, ("0.0", "1.0")),
        (0.0021034, 2.3e-5, ("0.002103", "0.000023")),
        (3.204e-8, 1.1e-9, ("3.20e-08", "1.1e-09")),
        (2e9, 3e5, ("2.00000e+09", "3.0e+05")),
        (268.531, None, ("268.53", "–")),
        (5.0, 0.0, ("5", "–")),
        (5.0, float("nan"), ("5", "–")),
    ],
)
def test_a_value_ends_where_its_standard_deviation_ends(
    value: float, std: float | None, shown: tuple[str, str]
) -> None:
    assert with_std(value, std) == shown


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e4))
def test_no_more_is_lost_than_half_of_the_last_digit(value: float, std: float) -> None:
    one, other = with_std(value, std)
    assert float(other) == pytest.approx(std, rel=0.0501)
    assert abs(float(one) - value) <= 0.0501 * float(other)
    assert len(one.partition(".")[2]) == len(other.partition(".")[2])


def test_axes_of_the_sheet_and_their_difference_from_cad_as_in_the_report() -> None:
    """Percent of the identified: as Table 1 of the report, and the map of its differences."""
    sheet = Sheet.read(stored("sheet"), "")
    axis = sheet.axes[0].model_copy(
        update={"cad": 90.0, "identified": 100.234, "std": 0.95, "motor": 0.01, "motor_std": 9.5e-5}
    )
    text = as_markdown(sheet.model_copy(update={"axes": (axis,)}))
    assert f"| {axis.joint} | 90.00 kg m² | 100.23 kg m² | 0.95 kg m² |" in text
    assert "| +10.2 %, " in text
    assert f"| {axis.joint} | 0.010000 | 0.000095 |" in text
