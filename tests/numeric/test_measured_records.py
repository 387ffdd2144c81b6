"""The page of records with a reference tells what is computed today."""

import re
from decimal import Decimal
from pathlib import Path

import pytest

from tests.measured_records import EMPS, LOOP, PAGE, TABLE, TOP, lines, records

NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def test_every_record_has_its_row(shared: Path) -> None:
    text = PAGE.read_text("utf-8")
    assert text.startswith(TOP)
    assert re.findall(r"^\| (\S+/\S+) ", text, re.MULTILINE) == records(shared / "data")


@pytest.mark.parametrize("name", [EMPS, TABLE, LOOP, "foreign/04"])
def test_a_row_is_what_is_computed(name: str, shared: Path) -> None:
    now = lines(shared / "data", name)
    told = [line for line in PAGE.read_text("utf-8").splitlines() if line.startswith((f"| {name} ", f"- {name}:"))]
    assert [NUMBER.sub("#", line) for line in told] == [NUMBER.sub("#", line) for line in now]
    for printed, computed in zip(NUMBER.findall("".join(told)), NUMBER.findall("".join(now)), strict=True):
        last_digit = Decimal(1).scaleb(int(Decimal(printed).as_tuple().exponent))
        assert abs(Decimal(printed) - Decimal(computed)) <= last_digit, (printed, computed)
