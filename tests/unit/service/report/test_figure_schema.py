"""Figures as the drawing on paper reads them: each word that the makers use is known, and no other."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from service.configuration import read_robot
from service.report import axes_of, diagnosis_figures
from service.report.drawing import Figure, Part, figure, points, scale
from service.report.figures import curve, deviation_map, in_frequency, in_time, paper_residuals, residuals, surface
from service.report.initial_analysis import amplitude_responses, ideal_frequencies
from service.report.paper.schema import Bar, Contour, Heatmap, Scatter, Scatter3d, Surface, read_figure
from service.results.diagnosis import Diagnosis
from tests.stored.documents import stored
from tests.unit.service.identification.test_ideal_frequency import analysis
from tests.unit.service.report.test_report import content, sweep

AXES = {"height": 300, "xaxis": scale("x"), "yaxis": scale("y")}
POINTS = points("one", [1.0], np.array([0.5]), "#000000")


def of_an_estimate(root: Path) -> Iterator[Figure]:
    robot = read_robot(root / "config" / "robots" / "max100-class.yaml")
    axes = axes_of(content(robot))
    yield from (residuals(axes), paper_residuals(axes), in_time(sweep()), in_frequency(sweep()))
    for axis in axes:
        if len(axis.varied) > 1:
            yield surface(robot, axis)
            yield deviation_map(robot, axis)
        else:
            yield curve(robot, axis)


def of_diagnoses() -> Iterator[Figure]:
    for name in ("diagnosis-named", "diagnosis-open"):
        for figures in diagnosis_figures(Diagnosis.read(stored(name), name)).values():
            yield from figures.values()


def test_every_figure_is_read_with_its_type_of_trace_and_all_its_axes(root: Path) -> None:
    found = analysis(noise=1e-5)
    figures = [*of_an_estimate(root), *of_diagnoses(), amplitude_responses(found), ideal_frequencies(found)]
    read = [read_figure(one) for one in figures]
    assert {type(trace) for one in read for trace in one.data} == {Bar, Contour, Heatmap, Scatter, Scatter3d, Surface}
    for one, given in zip(read, figures, strict=True):
        assert len(one.layout.axes) == sum(key[1:].startswith("axis") for key in given["layout"])


@pytest.mark.parametrize(
    ("trace", "told"),
    [
        ({"type": "pie", "values": [1.0]}, "pie"),
        ({**POINTS, "colour": "red"}, "colour"),
        ({**POINTS, "mode": "lines+markers"}, "mode"),
        ({**POINTS, "marker": {"symbol": "bowtie"}}, "symbol"),
        ({**POINTS, "line": {"dash": "longdash"}}, "dash"),
        ({**POINTS, "x": [[1.0]]}, "x"),
    ],
)
def test_a_trace_in_other_words_is_refused(trace: Part, told: str) -> None:
    with pytest.raises(ValidationError, match=told):
        read_figure(figure([trace], AXES))


@pytest.mark.parametrize(
    ("layout", "told"),
    [
        ({"polar": {}}, "polar"),
        ({"xaxis2": {**scale("x"), "side": "top"}}, "side"),
        ({"shapes": [{"type": "circle"}]}, "circle"),
        ({"annotations": [{"text": "here"}]}, "xanchor"),
    ],
)
def test_a_layout_in_other_words_is_refused(layout: Part, told: str) -> None:
    with pytest.raises(ValidationError, match=told):
        read_figure(figure([POINTS], {**AXES, **layout}))


def test_what_a_figure_leaves_open_is_told_by_the_models() -> None:
    read = read_figure(figure([{"mode": "lines", "x": [1.0], "y": [None]}], AXES))
    (trace,) = read.data
    assert isinstance(trace, Scatter)
    assert (trace.line.width, trace.line.dash, trace.xaxis) == (1.8, "solid", "x")
    assert read.layout.showlegend
