"""Maps of one panel: colour fields with their key, and contour lines with their values."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

from service.report.paper.marks import rectangle
from service.report.paper.scales import Scale, round_steps, tick_label
from service.report.paper.schema import ColourScale, Contour, Heatmap, Rows
from service.report.paper.svg import Point, path, text

_STEPS = 40  # colours of a key


def blend(scale: ColourScale, share: float) -> str:
    """The colour of a colour scale at 0 ... 1."""
    share = min(max(share, 0.0), 1.0)
    for (low, first), (high, second) in pairwise(scale):
        if share <= high:
            part = 0.0 if high == low else (share - low) / (high - low)
            pairs = zip(_rgb(first), _rgb(second), strict=True)
            return "#" + "".join(f"{round(a + part * (b - a)):02x}" for a, b in pairs)
    return scale[-1][1]


def fields(trace: Heatmap, x: Scale, y: Scale) -> Iterator[str]:
    """A heat map: one rectangle for each grid point with a value."""
    xs, ys = _edges([x.place(value) for value in trace.x]), _edges([y.place(value) for value in trace.y])
    low, high = trace.zmin, trace.zmax
    for j, row in enumerate(trace.z):
        for i, value in enumerate(row):
            if value is None:
                continue
            colour = blend(trace.colorscale, (value - low) / ((high - low) or 1.0))
            box = (min(xs[i], xs[i + 1]), min(ys[j], ys[j + 1]), abs(xs[i + 1] - xs[i]), abs(ys[j + 1] - ys[j]))
            yield rectangle(box, colour, stroke=colour, stroke_width=0.4)


def key(trace: Heatmap, left: float, top: float, bottom: float) -> Iterator[str]:
    """The key of a heat map: a colour bar with a scale."""
    low, high = trace.zmin, trace.zmax
    step = (bottom - top) / _STEPS
    for k in range(_STEPS):
        colour = blend(trace.colorscale, 1 - (k + 0.5) / _STEPS)
        yield rectangle((left, top + k * step, 12, step + 0.3), colour)
    for value in round_steps(low, high, 5):
        height = bottom - (value - low) / ((high - low) or 1.0) * (bottom - top)
        yield text(tick_label(value), left + 16, height + 4, "start", 11)
    yield text(trace.colorbar.title.text, left, top - 6, "start", 11)


def levels(trace: Contour, x: Scale, y: Scale) -> Iterator[str]:
    """Contour lines through a grid, each with its value once."""
    rows = trace.z
    xs, ys = [x.place(value) for value in trace.x], [y.place(value) for value in trace.y]
    known = [value for row in rows for value in row if value is not None]
    if not known or min(known) == max(known):
        return
    for level in round_steps(min(known), max(known), trace.ncontours):
        parts = list(_crossings(rows, xs, ys, level))
        if not parts:
            continue
        yield path(parts, stroke=trace.line.color, stroke_width=trace.line.width)
        (ax, ay), (bx, by) = parts[len(parts) // 2]
        yield text(tick_label(level), (ax + bx) / 2, (ay + by) / 2 - 2, size=10, colour="#0f172a")


def _crossings(rows: Rows, xs: Sequence[float], ys: Sequence[float], level: float) -> Iterator[tuple[Point, Point]]:
    """The segments of a contour line, one or two per cell of the grid (marching squares)."""
    for j in range(len(ys) - 1):
        for i in range(len(xs) - 1):
            corners = ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))
            values = [rows[b][a] for a, b in corners]
            cut: list[Point] = []
            for k in range(4):
                (a, b), (c, d) = corners[k], corners[(k + 1) % 4]
                u, v = values[k], values[(k + 1) % 4]
                if u is not None and v is not None and (u < level) != (v < level) and None not in values:
                    part = (level - u) / (v - u)
                    cut.append((xs[a] + part * (xs[c] - xs[a]), ys[b] + part * (ys[d] - ys[b])))
            yield from zip(cut[::2], cut[1::2], strict=True)


def _edges(at: Sequence[float]) -> list[float]:
    """Borders half-way between grid points, and at the same distance outside the first and the last."""
    if len(at) < 2:
        return [at[0] - 10, at[0] + 10]
    between = [(a + b) / 2 for a, b in pairwise(at)]
    return [2 * at[0] - between[0], *between, 2 * at[-1] - between[-1]]


def _rgb(colour: str) -> tuple[int, int, int]:
    number = int(colour[1:], 16)
    return math.floor(number / 65536), number // 256 % 256, number % 256
