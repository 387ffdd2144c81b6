"""A figure of a report as SVG: the description that plotly.js draws on the screen, drawn without it."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain

from service.report.drawing import GRID, Figure
from service.report.paper import legend, maps, marks
from service.report.paper.frame import Frame, frame_of
from service.report.paper.ink import AXIS, Point, element, path, text, width
from service.report.paper.space import surfaces

Patterns = Mapping[str, str | None]

PAPER = 680.0  # px: what A4 leaves between the margins


def svg(figure: Figure, number: int) -> str:
    """The drawing as wide as the paper; what names a greater width is made smaller. `number`: for names inside."""
    layout = figure["layout"]
    figure = {"layout": layout, "data": [{"type": "scatter", **trace} for trace in figure["data"]]}
    wide, high = float(layout.get("meta", {}).get("width", PAPER)), float(layout["height"])
    placed = legend.entries(figure, wide - 20)
    top = legend.LINE * (placed[-1][1] + 1) + 8 if placed else 6.0
    patterns = legend.dashes(figure["data"])
    if "scene" in layout:
        wide, high = PAPER, 430.0
        body = surfaces(figure, wide, top, high)
    else:
        frame = frame_of(figure, wide, top)
        body = "".join(_flat(figure, frame, patterns, number))
    return element(
        "svg",
        f"{marks.HATCH}{''.join(legend.drawn(placed, 10, patterns))}{body}",
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {wide:.0f} {high:.0f}",
        width=PAPER,
        height=high * PAPER / wide,
        font_family="sans-serif",
    )


def _flat(figure: Figure, frame: Frame, patterns: Patterns, number: int) -> Iterator[str]:
    layout, traces = figure["layout"], figure["data"]
    shapes: Sequence[Figure] = layout.get("shapes", [])
    yield from (_shape(shape, frame) for shape in shapes if shape.get("layer") == "below")
    for k, pair in enumerate(frame.pairs):
        own = [trace for trace in traces if (trace.get("xaxis", "x"), trace.get("yaxis", "y")) == pair]
        yield from _grid(pair, frame)
        name = f"panel-{number}-{k}"
        left, top, right, bottom = frame.box(pair)
        hole = marks.rectangle((left - 1, top - 1, right - left + 2, bottom - top + 2), "black")
        yield element("defs", element("clipPath", hole, id=name))
        yield from chain.from_iterable(_unclipped(trace, pair, frame, own, layout) for trace in own)
        yield element("g", "".join(_traces(own, pair, frame, patterns)), clip_path=f"url(#{name})")
        yield path([[(left, top), (left, bottom), (right, bottom)]], stroke=AXIS, stroke_width=1)
    yield from (_shape(shape, frame) for shape in shapes if shape.get("layer") != "below")
    yield from frame.labels()
    notes: Sequence[Figure] = layout.get("annotations", ())
    yield from (_words(note, notes, frame) for note in notes)


def _traces(own: Sequence[Figure], pair: tuple[str, str], frame: Frame, patterns: Patterns) -> Iterator[str]:
    x, y = frame.scales[pair[0]], frame.scales[pair[1]]
    before: list[Point] = []
    for trace in own:
        if trace["type"] == "heatmap":
            yield from maps.fields(trace, x, y)
        elif trace["type"] == "contour":
            yield from maps.levels(trace, x, y)
        elif trace["type"] == "scatter":
            if "lines" in trace["mode"]:
                yield marks.curve(trace, x, y, before, legend.dash_of(trace, patterns))
                before = marks.places(trace, x, y)
            if "markers" in trace["mode"]:
                yield from marks.points(trace, x, y)


def _unclipped(
    trace: Figure, pair: tuple[str, str], frame: Frame, own: Sequence[Figure], layout: Figure
) -> Iterator[str]:
    """What may reach over its panel: words beside bars, the key of a map."""
    x, y = frame.scales[pair[0]], frame.scales[pair[1]]
    if trace["type"] == "heatmap":
        _, top, right, bottom = frame.box(pair)
        yield from maps.key(trace, right + 14, top + 14, bottom)
    if trace["type"] != "bar":
        return
    bars = [other for other in own if other["type"] == "bar"]
    if layout.get("barmode") == "overlay":
        yield from marks.bars(trace, x, y, 0.0, trace.get("width", 0.8))
        return
    breadth = (1 - layout.get("bargap", 0.2)) / len(bars)
    place = next(k for k, other in enumerate(bars) if other is trace)
    yield from marks.bars(trace, x, y, (place - (len(bars) - 1) / 2) * breadth, breadth)


def _grid(pair: tuple[str, str], frame: Frame) -> Iterator[str]:
    left, top, right, bottom = frame.box(pair)
    for name, upright in zip(pair, (True, False), strict=True):
        axis, scale = frame.axis(name), frame.scales[name]
        if axis.get("showgrid") is not False:
            lines = [[(p, top), (p, bottom)] if upright else [(left, p), (right, p)] for p, _ in scale.ticks]
            yield path(lines, stroke=GRID, stroke_width=0.8)
        if axis.get("zeroline") and min(scale.low, scale.high) <= 0 <= max(scale.low, scale.high):
            p = scale.place(0.0)
            yield path([[(p, top), (p, bottom)] if upright else [(left, p), (right, p)]], stroke="#64748b")


def _shape(shape: Figure, frame: Frame) -> str:
    """A shape; nothing where it lies beyond its scale."""
    if shape["xref"] != "paper" and not frame.scales[shape["xref"]].reaches(shape["x0"]):
        return ""
    x0, x1 = (frame.across(shape["xref"], shape[key]) for key in ("x0", "x1"))
    y0, y1 = (frame.down(shape["yref"], shape[key]) for key in ("y0", "y1"))
    if shape["type"] == "rect":
        return marks.rectangle((min(x0, x1), min(y0, y1), abs(x1 - x0), abs(y1 - y0)), shape["fillcolor"])
    line = shape["line"]
    dash = marks.DASHES[line.get("dash", "solid")]
    return path([[(x0, y0), (x1, y1)]], stroke=line["color"], stroke_width=line["width"], stroke_dasharray=dash)


def _words(note: Figure, notes: Sequence[Figure], frame: Frame) -> str:
    """A title of a panel, small enough to end before the next one on its line."""
    x, y = frame.across("paper", note["x"]), frame.down("paper", note["y"])
    lower = {"bottom": -2.0, "top": 12.0}[note["yanchor"]] - note.get("yshift", 0)
    anchor = {"left": "start", "right": "end"}[note["xanchor"]]
    size = float(note["font"]["size"])
    if anchor == "start":
        beside = [other["x"] for other in notes if other["y"] == note["y"] and other["x"] > note["x"]]
        room = frame.across("paper", min(beside, default=1.0)) - x - 6
        size *= min(1.0, room / width(note["text"], size))
    return text(note["text"], x, y + lower, anchor, size)
