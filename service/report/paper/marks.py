"""Elements in one panel of a figure: curves, bands, points with their errors, bars."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

from service.report.paper.scales import Scale
from service.report.paper.schema import Bar, Scatter
from service.report.paper.svg import Point, element, marker, path, text

DASHES: Mapping[str, str | None] = {"solid": None, "dash": "6 4", "dot": "1.5 3", "dashdot": "7 3 1.5 3"}
HATCHED = "url(#hatched)"
HATCH = element(
    "defs",
    element(
        "pattern",
        element("path", d="M0 6L6 0", stroke="white", stroke_width=1.6),
        id="hatched",
        width=6.0,
        height=6.0,
        patternUnits="userSpaceOnUse",
    ),
)


def curve(trace: Scatter, x: Scale, y: Scale, before: Sequence[Point], dash: str | None) -> str:
    """A curve, with the band to the curve `before` if it has one; gaps where a value is missing."""
    drawn = ""
    parts = _unbroken(trace, x, y)
    if trace.fill is not None and before:
        around = [*before, *reversed([point for part in parts for point in part])]
        points = " ".join(f"{a:.2f},{b:.2f}" for a, b in around)
        drawn += element("polygon", points=points, fill=opaque(trace.fillcolor))
    line = trace.line
    if line.width > 0:
        drawn += path(
            parts,
            stroke=line.color,
            stroke_width=0.8 * line.width,
            stroke_dasharray=dash,
            stroke_linejoin="round",
        )
    return drawn


def places(trace: Scatter, x: Scale, y: Scale) -> list[Point]:
    """Positions of the points of a trace, without the missing ones."""
    return [point for part in _unbroken(trace, x, y) for point in part]


def points(trace: Scatter, x: Scale, y: Scale) -> Iterator[str]:
    """Markers over their error bars."""
    look = trace.marker
    for k, (a, b) in enumerate(zip(trace.x, trace.y, strict=True)):
        at = _both(x.at(a), y.at(b))
        if at is None:
            continue
        for errors, scale, value in ((trace.error_x, x, a), (trace.error_y, y, b)):
            half = errors.array[k] if errors is not None else None
            if half and value is not None:
                number = scale.names.index(value) if isinstance(value, str) else value
                yield _error(at, scale.at(number - half), scale.at(number + half), scale is x, look.color)
        yield marker(look.symbol, at, look.size, look.color)


def bars(trace: Bar, x: Scale, y: Scale, offset: float, breadth: float) -> Iterator[str]:
    """Bars from zero; `offset` and `breadth` in steps of the categories. `text` is written at their ends."""
    lying = trace.orientation == "h"
    along, across = (x, y) if lying else (y, x)
    colours, labels = trace.marker.color, trace.text
    values, names = (trace.x, trace.y) if lying else (trace.y, trace.x)
    for k, (value, name) in enumerate(zip(values, names, strict=True)):
        end, zero = along.at(value), along.place(0.0)
        if end is None or not isinstance(name, str):
            continue
        middle = across.names.index(name) + offset
        a, b = sorted((across.place(middle - breadth / 2), across.place(middle + breadth / 2)))
        low, high = sorted((zero, end))
        box = (low, a, high - low, b - a) if lying else (a, low, b - a, high - low)
        yield rectangle(box, colours if isinstance(colours, str) else colours[k])
        if trace.marker.pattern.shape:
            yield rectangle(box, HATCHED)
        if labels is not None and lying:
            side = end < zero
            yield text(labels[k], end + (-4 if side else 4), (a + b) / 2 + 4, "end" if side else "start", 11)


def rectangle(box: tuple[float, float, float, float], fill: str, **more: str | float | None) -> str:
    """Left, top, width, height in px."""
    left, top, wide, high = box
    return element("rect", x=left, y=top, width=max(wide, 0.0), height=max(high, 0.0), fill=fill, **more)


def opaque(colour: str) -> str:
    """A colour for SVG, on white: `rgba(r,g,b,alpha)` without alpha."""
    if not colour.startswith("rgba"):
        return colour
    *rgb, share = (float(part) for part in colour[5:-1].split(","))
    return "#" + "".join(f"{round(255 + share * (part - 255)):02x}" for part in rgb)


def _error(at: Point, low: float | None, high: float | None, lying: bool, colour: str) -> str:
    if low is None or high is None:
        return ""
    x, y = at
    if lying:
        parts = [[(low, y), (high, y)], *([(end, y - 3), (end, y + 3)] for end in (low, high))]
    else:
        parts = [[(x, low), (x, high)], *([(x - 3, end), (x + 3, end)] for end in (low, high))]
    return path(parts, stroke=colour, stroke_width=1)


def _unbroken(trace: Scatter, x: Scale, y: Scale) -> list[list[Point]]:
    found = [_both(x.at(a), y.at(b)) for a, b in zip(trace.x, trace.y, strict=True)]
    ends = [-1, *(k for k, point in enumerate(found) if point is None), len(found)]
    parts = [found[a + 1 : b] for a, b in pairwise(ends)]
    return [[point for point in part if point is not None] for part in parts if part]


def _both(a: float | None, b: float | None) -> Point | None:
    return None if a is None or b is None else (a, b)
