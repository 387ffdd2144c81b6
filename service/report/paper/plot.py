"""A figure of a report as SVG, from the description that plotly.js draws on the screen, without plotly.js."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain

from service.report.drawing import GRID, Figure
from service.report.paper import legend, maps, marks
from service.report.paper.frame import Frame, frame_of
from service.report.paper.schema import (
    Annotation,
    Bar,
    Contour,
    FigureModel,
    Flat,
    Heatmap,
    Layout,
    Scatter,
    Shape,
    read_figure,
)
from service.report.paper.schema.layout import PAPER
from service.report.paper.surfaces import surfaces
from service.report.paper.svg import AXIS, Point, element, path, text, width

Patterns = Mapping[str, str | None]


def svg(figure: Figure, number: int) -> str:
    """The drawing in the width of the paper; wider figures are scaled down. `number`: for unique ids inside."""
    read = read_figure(figure)
    layout = read.layout
    wide, high = layout.meta.width, layout.height
    placed = legend.entries(read, wide - 20)
    top = legend.LINE * (placed[-1][1] + 1) + 8 if placed else 6.0
    patterns = legend.dashes(read.data)
    if layout.scene is not None:
        wide, high = PAPER, 430.0
        body = surfaces(read.data, layout.scene, wide, top, high)
    else:
        frame = frame_of(read, wide, top)
        body = "".join(_flat(read, frame, patterns, number))
    return element(
        "svg",
        f"{marks.HATCH}{''.join(legend.drawn(placed, 10, patterns))}{body}",
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {wide:.0f} {high:.0f}",
        width=PAPER,
        height=high * PAPER / wide,
        font_family="sans-serif",
    )


def _flat(figure: FigureModel, frame: Frame, patterns: Patterns, number: int) -> Iterator[str]:
    layout = figure.layout
    yield from (_shape(shape, frame) for shape in layout.shapes if shape.layer == "below")
    for k, pair in enumerate(frame.pairs):
        own = [trace for trace in figure.data if isinstance(trace, Flat) and (trace.xaxis, trace.yaxis) == pair]
        yield from _grid(pair, frame)
        name = f"panel-{number}-{k}"
        left, top, right, bottom = frame.box(pair)
        hole = marks.rectangle((left - 1, top - 1, right - left + 2, bottom - top + 2), "black")
        yield element("defs", element("clipPath", hole, id=name))
        yield from chain.from_iterable(_unclipped(trace, pair, frame, own, layout) for trace in own)
        yield element("g", "".join(_traces(own, pair, frame, patterns)), clip_path=f"url(#{name})")
        yield path([[(left, top), (left, bottom), (right, bottom)]], stroke=AXIS, stroke_width=1)
    yield from (_shape(shape, frame) for shape in layout.shapes if shape.layer == "above")
    yield from frame.labels()
    yield from (_words(note, layout.annotations, frame) for note in layout.annotations)


def _traces(own: Sequence[Flat], pair: tuple[str, str], frame: Frame, patterns: Patterns) -> Iterator[str]:
    x, y = frame.scales[pair[0]], frame.scales[pair[1]]
    before: list[Point] = []
    for trace in own:
        if isinstance(trace, Heatmap):
            yield from maps.fields(trace, x, y)
        elif isinstance(trace, Contour):
            yield from maps.levels(trace, x, y)
        elif isinstance(trace, Scatter) and trace.mode == "lines":
            yield marks.curve(trace, x, y, before, legend.dash_of(trace, patterns))
            before = marks.places(trace, x, y)
        elif isinstance(trace, Scatter):
            yield from marks.points(trace, x, y)


def _unclipped(trace: Flat, pair: tuple[str, str], frame: Frame, own: Sequence[Flat], layout: Layout) -> Iterator[str]:
    """Elements that may extend outside their panel: text next to bars, the key of a map."""
    x, y = frame.scales[pair[0]], frame.scales[pair[1]]
    if isinstance(trace, Heatmap):
        _, top, right, bottom = frame.box(pair)
        yield from maps.key(trace, right + 14, top + 14, bottom)
    if not isinstance(trace, Bar):
        return
    bars = [other for other in own if isinstance(other, Bar)]
    if layout.barmode == "overlay":
        yield from marks.bars(trace, x, y, 0.0, trace.width)
        return
    breadth = (1 - layout.bargap) / len(bars)
    place = next(k for k, other in enumerate(bars) if other is trace)
    yield from marks.bars(trace, x, y, (place - (len(bars) - 1) / 2) * breadth, breadth)


def _grid(pair: tuple[str, str], frame: Frame) -> Iterator[str]:
    left, top, right, bottom = frame.box(pair)
    for name, upright in zip(pair, (True, False), strict=True):
        axis, scale = frame.axis(name), frame.scales[name]
        if axis.showgrid:
            lines = [[(p, top), (p, bottom)] if upright else [(left, p), (right, p)] for p, _ in scale.ticks]
            yield path(lines, stroke=GRID, stroke_width=0.8)
        if axis.zeroline and min(scale.low, scale.high) <= 0 <= max(scale.low, scale.high):
            p = scale.place(0.0)
            yield path([[(p, top), (p, bottom)] if upright else [(left, p), (right, p)]], stroke="#64748b")


def _shape(shape: Shape, frame: Frame) -> str:
    """A shape; empty if it is outside its scale."""
    if shape.xref != "paper" and not frame.scales[shape.xref].reaches(shape.x0):
        return ""
    x0, x1 = (frame.across(shape.xref, x) for x in (shape.x0, shape.x1))
    y0, y1 = (frame.down(shape.yref, y) for y in (shape.y0, shape.y1))
    if shape.type == "rect":
        return marks.rectangle((min(x0, x1), min(y0, y1), abs(x1 - x0), abs(y1 - y0)), shape.fillcolor)
    line = shape.line
    dash = marks.DASHES[line.dash]
    return path([[(x0, y0), (x1, y1)]], stroke=line.color, stroke_width=line.width, stroke_dasharray=dash)


def _words(note: Annotation, notes: Sequence[Annotation], frame: Frame) -> str:
    """A title of a panel, small enough to end before the next one in its line."""
    x, y = frame.across("paper", note.x), frame.down("paper", note.y)
    lower = {"bottom": -2.0, "top": 12.0}[note.yanchor] - note.yshift
    size = note.font.size
    if note.xanchor == "right":
        return text(note.text, x, y + lower, "end", size)
    beside = [other.x for other in notes if other.y == note.y and other.x > note.x]
    room = frame.across("paper", min(beside, default=1.0)) - x - 6
    return text(note.text, x, y + lower, "start", size * min(1.0, room / width(note.text, size)))
