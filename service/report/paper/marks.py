"""What is drawn in one panel of a figure: curves, bands, points with their errors, bars."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

from service.report.drawing import Figure
from service.report.paper.ink import Point, element, marker, path, text
from service.report.paper.scales import Scale

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


def curve(trace: Figure, x: Scale, y: Scale, before: Sequence[Point], dash: str | None) -> str:
    """A curve, with the band to the curve `before` where it has one; gaps where a value is missing."""
    drawn = ""
    parts = _unbroken(trace, x, y)
    if trace.get("fill") == "tonexty" and before:
        around = [*before, *reversed([point for part in parts for point in part])]
        points = " ".join(f"{a:.2f},{b:.2f}" for a, b in around)
        drawn += element("polygon", points=points, fill=opaque(trace.get("fillcolor", "#cbd5e1")))
    line: Figure = trace.get("line", {})
    if line.get("width", 1.8) > 0:
        drawn += path(
            parts,
            stroke=line.get("color", "#334155"),
            stroke_width=0.8 * line.get("width", 1.8),
            stroke_dasharray=dash,
            stroke_linejoin="round",
        )
    return drawn


def places(trace: Figure, x: Scale, y: Scale) -> list[Point]:
    """Where the points of a trace lie, without the missing ones."""
    return [point for part in _unbroken(trace, x, y) for point in part]


def points(trace: Figure, x: Scale, y: Scale) -> Iterator[str]:
    """Markers over their error bars."""
    look: Figure = trace.get("marker", {})
    colour, symbol = look.get("color", "#334155"), look.get("symbol", "circle")
    for k, (a, b) in enumerate(zip(trace["x"], trace["y"], strict=True)):
        at = _both(x.at(a), y.at(b))
        if at is None:
            continue
        for name, scale, value in (("error_x", x, a), ("error_y", y, b)):
            half = trace[name]["array"][k] if name in trace else None
            if half:
                number = scale.names.index(value) if isinstance(value, str) else value
                yield _error(at, scale.at(number - half), scale.at(number + half), name == "error_x", colour)
        yield marker(symbol, at, look.get("size", 7), colour)


def bars(trace: Figure, x: Scale, y: Scale, offset: float, breadth: float) -> Iterator[str]:
    """Bars from zero; `offset` and `breadth` in steps of the categories. Words of `text` stand at their ends."""
    lying = trace.get("orientation") == "h"
    along, across = (x, y) if lying else (y, x)
    look: Figure = trace.get("marker", {})
    hatched = bool(look.get("pattern", {}).get("shape"))
    told: Sequence[str] | None = trace.get("text")
    values, names = (trace["x"], trace["y"]) if lying else (trace["y"], trace["x"])
    for k, (value, name) in enumerate(zip(values, names, strict=True)):
        end, zero = along.at(value), along.place(0.0)
        if end is None or name is None:
            continue
        middle = across.names.index(name) + offset
        a, b = sorted((across.place(middle - breadth / 2), across.place(middle + breadth / 2)))
        low, high = sorted((zero, end))
        box = (low, a, high - low, b - a) if lying else (a, low, b - a, high - low)
        colours: str | Sequence[str] = look["color"]
        yield rectangle(box, colours if isinstance(colours, str) else colours[k])
        if hatched:
            yield rectangle(box, HATCHED)
        if told is not None and lying:
            side = end < zero
            yield text(told[k], end + (-4 if side else 4), (a + b) / 2 + 4, "end" if side else "start", 11)


def rectangle(box: tuple[float, float, float, float], fill: str, **more: str | float | None) -> str:
    """Left, top, width, height in px."""
    left, top, wide, high = box
    return element("rect", x=left, y=top, width=max(wide, 0.0), height=max(high, 0.0), fill=fill, **more)


def opaque(colour: str) -> str:
    """A colour as SVG wants it, on white: `rgba(r,g,b,share)` without its share."""
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


def _unbroken(trace: Figure, x: Scale, y: Scale) -> list[list[Point]]:
    found = [_both(x.at(a), y.at(b)) for a, b in zip(trace["x"], trace["y"], strict=True)]
    ends = [-1, *(k for k, point in enumerate(found) if point is None), len(found)]
    parts = [found[a + 1 : b] for a, b in pairwise(ends)]
    return [[point for point in part if point is not None] for part in parts if part]


def _both(a: Any, b: Any) -> Point | None:
    return None if a is None or b is None else (a, b)
