"""The traces of a figure: curves and points, bars, maps, surfaces."""

from typing import Annotated, Literal

from pydantic import Discriminator, Tag

from service.report.drawing import Part
from service.report.paper.schema.parts import DARK, Drawing, Font, Stroke, Words

Value = str | float | None  # the name of a category, a number, or unknown
Numbers = tuple[float | None, ...]
Rows = tuple[Numbers, ...]  # one for each y
ColourScale = tuple[tuple[float, str], ...]  # colours at 0 ... 1
Symbol = Literal[
    "circle",
    "circle-open",
    "square",
    "square-open",
    "triangle-up",
    "triangle-up-open",
    "diamond",
    "diamond-open",
    "star",
    "star-open",
    "hexagon2",
    "hexagon2-open",
    "x-thin-open",
    "line-ew-open",
]


class Pattern(Drawing):
    """Hatching of a bar."""

    shape: Literal["", "/"] = ""


class Marker(Drawing):
    """A marker; `size` in px."""

    size: float = 7.0
    color: str = DARK
    symbol: Symbol = "circle"
    line: Stroke | None = None


class Filling(Drawing):
    """Of bars: one colour for all, or one for each."""

    color: str | tuple[str, ...]
    pattern: Pattern = Pattern()


class Errors(Drawing):
    """Half lengths of error bars, in the unit of the values; `thickness` and `width` in px."""

    array: Numbers
    color: str = DARK
    thickness: float = 1.0
    width: float = 3.0


class _Named(Drawing):
    """`hovertemplate`, `hoverinfo`, `customdata`: only on the screen."""

    name: str = ""
    showlegend: bool = True
    hovertemplate: str = ""
    hoverinfo: Literal["all", "skip"] = "all"
    customdata: Numbers = ()


class _InPanel(_Named):
    """A trace in the panel of two axes."""

    xaxis: str = "x"
    yaxis: str = "y"


class Scatter(_InPanel):
    """A curve or points. `fill`: the band to the previous curve. `text`: only on the screen."""

    type: Literal["scatter"] = "scatter"
    x: tuple[Value, ...]
    y: tuple[Value, ...]
    mode: Literal["lines", "markers"]
    line: Stroke = Stroke()
    marker: Marker = Marker()
    error_x: Errors | None = None
    error_y: Errors | None = None
    fill: Literal["tonexty"] | None = None
    fillcolor: str = "#cbd5e1"
    text: tuple[str, ...] = ()


class Bar(_InPanel):
    """Bars from zero, `width` in steps of the categories; `text` is at their ends."""

    type: Literal["bar"]
    x: tuple[Value, ...]
    y: tuple[Value, ...]
    orientation: Literal["h", "v"] = "v"
    width: float = 0.8
    marker: Filling
    text: tuple[str, ...] | None = None
    textposition: Literal["outside"] = "outside"
    cliponaxis: bool = True


class ColourBar(Drawing):
    """The key of a map; `thickness` in px."""

    title: Words
    thickness: float = 12.0


class _Grid(_InPanel):
    """Values over two linear scales."""

    x: tuple[float, ...]
    y: tuple[float, ...]
    z: Rows


class Heatmap(_Grid):
    """A colour field from `zmin` to `zmax`."""

    type: Literal["heatmap"]
    colorscale: ColourScale
    zmin: float
    zmax: float
    hoverongaps: bool = True
    colorbar: ColourBar


class Levels(Drawing):
    """Style of contour lines on the screen."""

    coloring: Literal["none"]
    showlabels: bool
    labelfont: Font


class Contour(_Grid):
    """Contour lines."""

    type: Literal["contour"]
    contours: Levels
    line: Stroke = Stroke()
    ncontours: int = 8
    showscale: Literal[False]


class Level(Drawing):
    """A contour line on a surface."""

    show: bool
    color: str
    width: float


class Contours(Drawing):
    """The lines on a surface, on the screen."""

    z: Level | None = None


class Surface(_Named):
    """A surface over two joints."""

    type: Literal["surface"]
    x: Numbers
    y: Numbers
    z: Rows
    colorscale: ColourScale
    opacity: float = 1.0
    contours: Contours = Contours()
    showscale: Literal[False]


class Scatter3d(_Named):
    """Points in space."""

    type: Literal["scatter3d"]
    mode: Literal["markers"]
    x: Numbers
    y: Numbers
    z: Numbers
    marker: Marker


Flat = Scatter | Bar | Heatmap | Contour
"""Traces in a panel."""


def _type(trace: Part) -> object:
    return trace.get("type", "scatter")


Trace = Annotated[
    Annotated[Scatter, Tag("scatter")]
    | Annotated[Bar, Tag("bar")]
    | Annotated[Heatmap, Tag("heatmap")]
    | Annotated[Contour, Tag("contour")]
    | Annotated[Surface, Tag("surface")]
    | Annotated[Scatter3d, Tag("scatter3d")],
    Discriminator(_type),
]
"""By its `type`; a trace without one is a scatter, as for plotly.js."""
