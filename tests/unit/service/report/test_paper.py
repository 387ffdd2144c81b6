"""A report on paper: its text read back from the PDF, and its figures as SVG."""

import io
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from html import escape
from typing import Any

import numpy as np
import pytest
from pypdf import PageObject, PdfReader

from service import NoPdf
from service.model import Robot
from service.model.results.diagnosis import Diagnosis
from service.report.campaign import campaign_page
from service.report.diagnosis import diagnosis_figures
from service.report.drawing import DrawnFigure, Part, figure, line, points, scale
from service.report.initial_analysis import amplitude_responses, ideal_frequencies
from service.report.plotting import PAPER_WIDTH, WIDTH, drawn, svg
from tests.programs import needs
from tests.stored.documents import stored
from tests.unit.service.identification.test_ideal_frequency import analysis
from tests.unit.service.report.test_campaign_report import SOUND, report
from tests.unit.service.report.test_report import content, estimate_page, figures, sweep

pytestmark = pytest.mark.slow

A4 = (595.28, 841.89)  # points


@pytest.fixture(scope="module")
def pages(max100: Robot) -> list[str]:
    """The text of each page of a campaign's report."""
    drawn = content(max100, example=sweep())
    read = PdfReader(io.BytesIO(campaign_page(report(), max100.joints, drawn.estimate, drawn).pdf()))
    assert all(
        (float(page.mediabox.width), float(page.mediabox.height)) == pytest.approx(A4, abs=1) for page in read.pages
    )
    assert read.metadata is not None
    assert read.metadata.title == "Campaign 1: <robot>"
    return [" ".join(page.extract_text().split()) for page in read.pages]


def lowest(page: PageObject) -> float:
    """Height of the lowest words above the number of the page, points."""
    found: list[float] = []
    page.extract_text(
        visitor_text=lambda text, cm, tm, *_: found.append(cm[5] + cm[3] * tm[5]) if text.strip() else None
    )
    return min(place % A4[1] for place in found if place % A4[1] > 40)


@needs("pango")
def test_no_page_is_half_empty(max100: Robot) -> None:
    drawn = content(max100, example=sweep())
    read = PdfReader(io.BytesIO(campaign_page(report(check=SOUND), max100.joints, drawn.estimate, drawn).pdf()))
    assert max(lowest(page) for page in read.pages[:-1]) < 0.4 * A4[1]
    assert len(read.pages[-1].extract_text()) > 300  # not "Nothing found." alone


@needs("pango")
def test_what_stands_on_paper(pages: list[str]) -> None:
    """Words of figures too: read by whoever searches the file, or has it read aloud."""
    for words in ("Contradicted.", "cannot be trusted", "J of joint_1", "joint_1 against CAD", "Ada <ada>", "cd" * 32):
        assert words in pages[0]
    whole = " ".join(pages)
    for words in ("4711", "not reported", "Contents"):
        assert words in whole
    for words in ("joint_2 in deg", "identified model", "time in s", "velocity, excited", "measured (± 2 std)"):
        assert words in whole
    assert "Figure 1. joint_1 against CAD" in whole
    assert "Figure 2. Inertia of the axes over the poses: joint_1 over joint_2 and joint_3" in whole
    contents = re.findall(r"(Base parameters|One sweep|Check of the data)[ .]*(\d+)", pages[1])
    assert len(contents) == 3
    for heading, number in contents:
        assert heading in pages[int(number) - 1]
    assert [page.count(f"{k} / {len(pages)}") for k, page in enumerate(pages, start=1)] == [1] * len(pages)
    numbers = re.findall(r"Figure (\d+)\.", whole)
    assert numbers == [str(k) for k in range(1, len(numbers) + 1)]
    assert len(numbers) >= 7


def test_where_pdf_cannot_be_made_it_is_told_what_to_install(max100: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "weasyprint", None)  # as where the extra is not installed
    with pytest.raises(NoPdf, match=r"install sweepid\[pdf\] and the system's Pango"):
        estimate_page(content(max100)).pdf()


def every_figure(max100: Robot) -> Iterator[DrawnFigure]:
    pages = [estimate_page(content(max100, example=sweep()))]
    yield from (part for page in pages for part in figures(page))
    for name in ("diagnosis-named", "diagnosis-open"):
        for by_name in diagnosis_figures(Diagnosis.read(stored(name), name)).values():
            yield from by_name.values()
    found = analysis(noise=1e-5)
    yield from (amplitude_responses(found), ideal_frequencies(found))


@pytest.mark.parametrize("width", [WIDTH, PAPER_WIDTH])
def test_every_figure_is_drawn_whole_with_all_its_words(max100: Robot, width: float) -> None:
    for described in every_figure(max100):
        layout: Any = described["layout"]
        canvas = drawn(described, width)
        wide, high = canvas.get_size_inches()
        box = canvas.get_tightbbox()
        assert 0 <= box.x0 <= box.x1 <= wide
        assert 0 <= box.y0 <= box.y1 <= high
        shown = svg(described, "title", width)
        titles = {axis["title"]["text"] for key, axis in layout.items() if key[1:5] == "axis"} - {""}
        names = {str(trace.get("name", "")) for trace in described["data"] if trace.get("showlegend", True)} - {""}
        for word in titles | (names if layout.get("showlegend", True) else set()):
            assert escape(str(word), quote=False) in shown
        assert "nan" not in shown
        ET.fromstring(shown)


AXES = {"height": 300, "xaxis": scale("x"), "yaxis": scale("y")}
POINTS = points("one", [1.0], np.array([0.5]), "#000000")


@pytest.mark.parametrize(("width", "size"), [(960.0, (960.0, 300.0)), (240.0, (240.0, 150.0))])
def test_a_figure_is_as_large_as_its_description_says(width: float, size: tuple[float, float]) -> None:
    """Its height is that of a page's width; on paper it is flatter. Words keep their size: one point is one px."""
    described = figure([POINTS], AXES)
    assert tuple(drawn(described, width).bbox.size) == pytest.approx(size)
    assert f'viewBox="0 0 {size[0]:.0f} {size[1]:.0f}"' in svg(described, "", width)


def test_lines_of_one_panel_differ_by_more_than_colour() -> None:
    y = np.array([1.0, 2.0])
    (axes,) = drawn(figure([line("a", [0, 1], y, "#112233"), line("b", [0, 1], 2 * y, "#445566")], AXES)).axes
    first, second = axes.get_lines()
    assert first.get_linestyle() != second.get_linestyle()


def test_what_is_missing_leaves_a_gap() -> None:
    shown = svg(figure([line("a", [0, 1, 2, 3, 4], np.array([1, 10, np.nan, 9, 5.0]), "#112233")], AXES), "")
    curves = re.findall(r'<path d="([^"]*)"[^>]*stroke: #112233', shown)
    assert max(curve.count("M") for curve in curves) == 2


@pytest.mark.parametrize(
    "trace", [{"type": "pie"}, {**POINTS, "marker": {"symbol": "bowtie", "size": 1, "color": "red"}}]
)
def test_a_figure_in_unknown_words_is_refused(trace: Part) -> None:
    with pytest.raises(KeyError):
        drawn(figure([{"x": [1.0], "y": [1.0], **trace}], AXES))
