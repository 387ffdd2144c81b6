"""The layout of a figure: size, axes, shapes, annotations, and the box of 3D surfaces."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from service.report.paper.schema.parts import DARK, Drawing, Font, Stroke, Words

PAPER = 680.0  # px: width of A4 between the margins

Pair = tuple[float, float]


class Margin(Drawing):
    """Px; plotly.js uses the first letters only."""

    left: Annotated[float, Field(alias="l")]
    right: Annotated[float, Field(alias="r")]
    top: Annotated[float, Field(alias="t")]
    bottom: Annotated[float, Field(alias="b")]


class LegendPlace(Drawing):
    """Position of the legend on the screen."""

    orientation: Literal["h"]
    x: float
    y: float
    yanchor: Literal["bottom"]


class HoverLabel(Drawing):
    """Only on the screen."""

    font: Font


class Meta(Drawing):
    """`width`: minimum width of a figure in px."""

    width: float = PAPER


class Axis(Drawing):
    """A scale of a panel. `domain`: its fraction of the area; `range`: exponents of ten if it is of type log."""

    title: Words = Words(text="")
    type: Literal["linear", "log", "category"] = "linear"
    domain: Pair = (0.0, 1.0)
    anchor: str | None = None
    range: Pair | None = None
    rangemode: Literal["normal", "tozero"] = "normal"
    autorange: Literal["reversed"] | None = None
    nticks: int | None = None
    tickvals: tuple[float, ...] | None = None
    ticktext: tuple[str, ...] | None = None
    tickfont: Font = Font(size=11.5)
    ticks: Literal["outside"] = "outside"
    tickcolor: str = DARK
    dtick: float | None = None
    exponentformat: Literal["power"] | None = None
    showgrid: bool = True
    gridcolor: str = DARK
    zeroline: bool = False
    zerolinecolor: str = DARK
    showline: bool = True
    linecolor: str = DARK
    automargin: bool = True


class Shape(Drawing):
    """A line, or a filled rectangle, between two corners; `xref` and `yref`: an axis, its panel, or all (`paper`)."""

    type: Literal["line", "rect"]
    xref: str
    yref: str
    x0: float
    x1: float
    y0: float
    y1: float
    line: Stroke
    fillcolor: str = "none"
    layer: Literal["above", "below"] = "above"


class Annotation(Drawing):
    """Text at a fraction of the whole area; `yshift` in px, upwards."""

    text: str
    hovertext: str = ""
    x: float
    y: float
    xref: Literal["paper"]
    yref: Literal["paper"]
    xanchor: Literal["left", "right"]
    yanchor: Literal["bottom", "top"]
    yshift: float = 0.0
    showarrow: Literal[False]
    font: Font


class Place(Drawing):
    """A position in space, or lengths along its axes."""

    x: float
    y: float
    z: float


class SceneAxis(Drawing):
    """An edge of the box."""

    title: Words


class Camera(Drawing):
    """`eye`: position of the viewer, relative to the centre of the box."""

    eye: Place
    center: Place


class Scene(Drawing):
    """The box that contains the surfaces."""

    xaxis: SceneAxis
    yaxis: SceneAxis
    zaxis: SceneAxis
    camera: Camera
    aspectratio: Place


class Layout(Drawing):
    """`height` in px; `axes` by the name in traces: `x2` is plotly's `xaxis2`. Colours: on the screen."""

    height: float
    axes: Mapping[str, Axis]
    margin: Margin
    meta: Meta = Meta()
    showlegend: bool = True
    barmode: Literal["group", "overlay"] = "group"
    bargap: float = 0.2
    annotations: tuple[Annotation, ...] = ()
    shapes: tuple[Shape, ...] = ()
    scene: Scene | None = None
    font: Font
    paper_bgcolor: str
    plot_bgcolor: str
    legend: LegendPlace
    hoverlabel: HoverLabel
