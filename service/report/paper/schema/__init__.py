"""A figure's description, read into models of all keys that figures use; any other key is an error."""

import re

from service.report.drawing import Figure
from service.report.paper.schema.layout import Annotation, Axis, Layout, Margin, Scene, Shape
from service.report.paper.schema.parts import Drawing, Stroke
from service.report.paper.schema.traces import (
    Bar,
    ColourScale,
    Contour,
    Flat,
    Heatmap,
    Rows,
    Scatter,
    Scatter3d,
    Surface,
    Trace,
    Value,
)

__all__ = [
    "Annotation",
    "Axis",
    "Bar",
    "ColourScale",
    "Contour",
    "FigureModel",
    "Flat",
    "Heatmap",
    "Layout",
    "Margin",
    "Rows",
    "Scatter",
    "Scatter3d",
    "Scene",
    "Shape",
    "Stroke",
    "Surface",
    "Trace",
    "Value",
    "read_figure",
]

_AXIS = re.compile(r"([xy])axis(\d*)")


class FigureModel(Drawing):
    """A figure."""

    data: tuple[Trace, ...]
    layout: Layout


def read_figure(figure: Figure) -> FigureModel:
    """The figure as models; pydantic's ValidationError names an unknown trace, key or value."""
    layout = figure["layout"]
    axes = {_AXIS.sub(r"\1\2", key): value for key, value in layout.items() if _AXIS.fullmatch(key)}
    rest = {key: value for key, value in layout.items() if not _AXIS.fullmatch(key)}
    return FigureModel.model_validate({"data": figure["data"], "layout": {**rest, "axes": axes}})
