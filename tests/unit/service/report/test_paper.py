"""A report on paper: its text read back from the PDF, and its figures as SVG."""

import io
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from pypdf import PdfReader

from service.configuration import read_robot
from service.report import NoPdf, axes_of, campaign_page, diagnosis_page, estimate_page
from service.report.drawing import DECADES, Figure, figure, line, points, scale
from service.report.figures import convergence, deviation_map, in_frequency, in_time
from service.report.paper.plot import svg
from service.report.paper.scales import round_steps, scale_of
from service.report.paper.schema import Axis
from service.results.diagnosis import Diagnosis
from service.robot import Robot
from tests.programs import needs
from tests.stored.documents import stored
from tests.unit.service.report.test_campaign_report import report
from tests.unit.service.report.test_report import content, sweep

pytestmark = pytest.mark.slow

A4 = (595.28, 841.89)  # points


@pytest.fixture(scope="module")
def max100(root: Path) -> Robot:
    return read_robot(root / "config" / "robots" / "max100-class.yaml")


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


@needs("pango")
def test_the_first_page_has_verdict_people_hashes_and_serial_numbers(pages: list[str]) -> None:
    for words in ("Contradicted.", "cannot be trusted", "Ada <ada>", "cd" * 32, "4711", "not reported", "Contents"):
        assert words in pages[0]


@needs("pango")
def test_contents_lead_to_the_pages_they_tell(pages: list[str]) -> None:
    told = re.findall(r"(Base parameters|One sweep|Check of the data)[ .]*(\d+)", pages[0])
    assert len(told) == 3
    for heading, number in told:
        assert heading in pages[int(number) - 1]


@needs("pango")
def test_pages_and_figures_are_numbered(pages: list[str]) -> None:
    assert [page.count(f"{k} / {len(pages)}") for k, page in enumerate(pages, start=1)] == [1] * len(pages)
    numbers = re.findall(r"Figure (\d+)\.", " ".join(pages))
    assert numbers == [str(k) for k in range(1, len(numbers) + 1)]
    assert len(numbers) >= 7
    assert "Figure 1. Inertia of the axes over the poses: joint_1 over joint_2 and joint_3" in " ".join(pages)


@needs("pango")
def test_words_of_the_figures_are_text(pages: list[str]) -> None:
    """Read by whoever searches the file, or has it read aloud."""
    whole = " ".join(pages)
    for words in ("joint_2 in deg", "identified model", "time in s", "velocity, excited", "measured (± 2 std)"):
        assert words in whole


@needs("pango")
@pytest.mark.parametrize("name", ["diagnosis-named", "diagnosis-open"])
def test_a_diagnosis_on_paper(name: str) -> None:
    document = Diagnosis.read(stored(name), name)
    file = diagnosis_page(document, "Diagnosis 7", "", (("robot", "arm"),)).pdf()
    text = " ".join(" ".join(page.extract_text() for page in PdfReader(io.BytesIO(file)).pages).split())
    for axis in document.axes.values():
        assert axis.summary.split(".", maxsplit=1)[0] in text
    assert "noise floor" in text


def test_where_pdf_cannot_be_made_it_is_told_what_to_install(max100: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "weasyprint", None)  # as where the extra is not installed
    with pytest.raises(NoPdf, match=r"install sweepid\[pdf\] and the system's Pango"):
        estimate_page(content(max100)).pdf()


def test_tables_alone(max100: Robot) -> None:
    page = estimate_page(content(max100))
    assert '"RMSE in %"' in str(page.written("json"))
    assert page.written("html") == page.html()


def drawn(described: Figure) -> ET.Element:
    return ET.fromstring(svg(described, 1))


def names(root: ET.Element, tag: str) -> list[ET.Element]:
    return list(root.iter(f"{{http://www.w3.org/2000/svg}}{tag}"))


def test_a_point_lies_where_its_scales_say() -> None:
    axes = {"height": 300, "xaxis": {**scale("x"), "range": [0, 4]}, "yaxis": {**scale("y"), "range": [0, 2]}}
    root = drawn(figure([points("one", [1.0, 3.0], np.array([0.5, 1.5]), "#000000")], axes))
    first, second = names(root, "circle")[1:]  # the first stands in the legend
    labels = {label.text: label for label in names(root, "text")}
    for number, circle in (("1", first), ("3", second)):
        assert float(circle.attrib["cx"]) == pytest.approx(float(labels[number].attrib["x"]), abs=0.1)
    assert float(first.attrib["cy"]) > float(second.attrib["cy"])  # px grow downwards


def test_lines_of_one_panel_differ_by_more_than_colour() -> None:
    axes = {"height": 300, "xaxis": scale("x"), "yaxis": scale("y")}
    y = np.array([1.0, 2.0])
    root = drawn(figure([line("a", [0, 1], y, "#112233"), line("b", [0, 1], 2 * y, "#445566")], axes))
    dashes = {e.attrib["stroke"]: e.attrib.get("stroke-dasharray") for e in names(root, "path") if "stroke" in e.attrib}
    assert dashes["#112233"] != dashes["#445566"]


def test_what_is_missing_leaves_a_gap_and_no_word() -> None:
    axes = {"height": 300, "xaxis": scale("x"), "yaxis": {**scale("y"), **DECADES}}
    root = drawn(figure([line("a", [0, 1, 2, 3, 4], np.array([1.0, 10.0, np.nan, 100.0, 50.0]), "#112233")], axes))
    (curve,) = [e for e in names(root, "path") if e.attrib.get("stroke") == "#112233" and e.attrib["d"].count("M") > 1]
    assert curve.attrib["d"].count("M") == 2
    assert "nan" not in ET.tostring(root, "unicode")


def test_the_figures_of_a_sweep_are_drawn_whole() -> None:
    for described in (in_time(sweep()), in_frequency(sweep()), convergence((), ())):
        if described["data"]:
            width, height = (float(v) for v in drawn(described).attrib["viewBox"].split()[2:])
            for words in names(drawn(described), "text"):
                assert 0 <= float(words.attrib["x"]) <= width
                assert 0 <= float(words.attrib["y"]) <= height


@pytest.mark.parametrize(
    ("low", "high", "most", "steps"),
    [(0, 10, 5, [0, 2, 4, 6, 8, 10]), (-1.2, 0.9, 4, [-1, -0.5, 0, 0.5]), (0.11, 0.19, 4, [0.12, 0.14, 0.16, 0.18])],
)
def test_round_steps(low: float, high: float, most: int, steps: list[float]) -> None:
    assert round_steps(low, high, most) == pytest.approx(steps)


def test_scales_of_values_that_are_all_alike_or_none() -> None:
    for values in ([2.0, 2.0], [0.0], []):
        found = scale_of(Axis(), values, False, 0.0, 100.0)
        assert all(0 <= (found.at(value) or 0.0) <= 100 for value in values)
        assert found.high > found.low


def test_a_map_shows_the_marks_of_its_outer_poses_whole(max100: Robot) -> None:
    report_content = content(max100)
    axis = next(one for one in axes_of(report_content) if len(one.varied) >= 2)
    drawn = ET.fromstring(svg(deviation_map(max100, axis), 1))
    cells = [one for one in drawn.iter() if one.tag.endswith("rect") and one.get("stroke-width") == "0.4"]
    left = min(float(one.get("x", "nan")) for one in cells)
    right = max(float(one.get("x", "nan")) + float(one.get("width", "nan")) for one in cells)
    _, *marks = [float(one.get("cx", "nan")) for one in drawn.iter() if one.tag.endswith("circle")]  # the first: legend
    assert left + 5 < min(marks) < max(marks) < right - 5
    (area,) = next(one for one in drawn.iter() if one.tag.endswith("clipPath"))
    assert float(area.get("x", "nan")) <= left + 1
