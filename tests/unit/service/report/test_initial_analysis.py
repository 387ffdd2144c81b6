"""Figures 1a and 1b from an analysis worked out by hand."""

import json
import re
from typing import Any

import numpy as np
import pytest

from service.identification.axis.ideal_frequency import AxisAnalysis
from service.identification.estimates.analysis_document import analyses_document
from service.report import analysis_page
from service.report.initial_analysis import amplitude_responses, ideal_frequencies, table
from tests.unit.service.campaigns.small_arm import small_arm
from tests.unit.service.identification.test_ideal_frequency import FREQUENCY, LOADS, STIFF, analysis


@pytest.fixture(scope="module")
def found() -> AxisAnalysis:
    return analysis(noise=1e-5)


def test_amplitude_responses_show_every_pose_twice(found: AxisAnalysis) -> None:
    drawn: Any = amplitude_responses(found)["data"]
    assert len(drawn) == 2 * len(LOADS)
    dots, fitted = ((np.array(one["x"], dtype=float), np.array(one["y"], dtype=float)) for one in drawn[:2])
    assert dots[0] == pytest.approx(FREQUENCY, rel=1e-5)
    assert dots[1] == pytest.approx(1 / np.abs(found.poses[0].response.impedance), rel=1e-5)
    assert np.interp(8.0, *fitted) == pytest.approx(np.interp(8.0, *dots), rel=0.05)


def test_ideal_frequencies_have_an_upright_at_each_end_and_between(found: AxisAnalysis) -> None:
    layout: Any = ideal_frequencies(found)["layout"]
    first = [shape["x0"] for shape in layout["shapes"] if shape["xref"] == "x"]
    corner, ideal, resonance = first
    assert ideal == pytest.approx(np.sqrt(corner * resonance))
    assert len(layout["annotations"]) == len(LOADS)
    assert layout["annotations"][0]["text"].startswith("J = 198 kg m²")


def test_the_table_has_both_ways_side_by_side(found: AxisAnalysis) -> None:
    head, rows = table({"j1": found}, ("j1", "j2"))
    assert len(rows) == len(LOADS)
    assert {len(row) for row in rows} == {len(head)}
    assert re.fullmatch(r"11\.57 ± 0\.\d\d \(11\.\d\)", rows[0][3])


def test_what_lies_above_the_band_is_not_told_to_a_tenth() -> None:
    stiff = analysis(train=STIFF)
    _, rows = table({"j1": stiff}, ("j1",))
    for row in rows:
        assert row[3] == "above 39"
        assert re.fullmatch(r"above \d\.\d\d → [2345]", row[5])
    layout: Any = ideal_frequencies(stiff)["layout"]
    texts = [note["text"] for note in layout["annotations"]]
    assert all(re.search(r"ideal above \d(\.\d)? Hz → [2345] Hz", text) for text in texts)


def test_the_page_holds_two_figures_an_axis(found: AxisAnalysis) -> None:
    page = analysis_page(small_arm(), analyses_document({"j1": found})).html()
    assert page.count("<figure>") == 2
    assert ">j1</h3>" in page


def test_a_linear_axis_has_its_own_units(found: AxisAnalysis) -> None:
    layout: Any = ideal_frequencies(found, linear=True)["layout"]
    assert layout["annotations"][0]["text"].startswith("J = 198 kg,")
    text = json.dumps([amplitude_responses(found, linear=True), ideal_frequencies(found, linear=True)])
    assert "m/s per N" in text
    assert "kg m" not in text
    head, rows = table({"j1": found}, ("j1", "j2"), {"j1"})
    assert head[1:3] == ["pose in deg, linear axes mm", "J in kg m², linear axes kg"]
    first = found.poses[0].pose
    assert rows[0][1].split(", ")[0] == f"{1e3 * first[0]:.0f}"
