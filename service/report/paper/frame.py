"""Positions of the panels of a figure, their scales, and the texts next to them."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from service.report.paper.scales import Scale, scale_of
from service.report.paper.schema import Axis, Bar, FigureModel, Flat, Heatmap, Layout, Scatter, Value
from service.report.paper.svg import text, width

Pair = tuple[str, str]

_TITLE = 20.0  # px next to the labels of a scale
_LABELS = 20.0  # px below a panel
_KEY = 58.0  # px for the key of a map
_WIDEST = 0.42  # of a figure, largest width of the labels left of it


@dataclass(frozen=True)
class Frame:
    """The panels: `pairs` of names of axes (`x`, `y2`), a scale each; `area`: left, top, right, bottom in px."""

    layout: Layout
    pairs: tuple[Pair, ...]
    scales: dict[str, Scale]
    area: tuple[float, float, float, float]

    def axis(self, name: str) -> Axis:
        return self.layout.axes[name]

    def box(self, pair: Pair) -> tuple[float, float, float, float]:
        """Left, top, right, bottom of a panel."""
        x, y = (self.axis(name).domain for name in pair)
        (left, right), (low, high) = x, y
        return (
            self.across("paper", left),
            self.down("paper", high),
            self.across("paper", right),
            self.down("paper", low),
        )

    def across(self, ref: str, value: float) -> float:
        """Px from the left of a value of an axis, or of a fraction of the whole area (`paper`)."""
        left, _, right, _ = self.area
        return left + value * (right - left) if ref == "paper" else _known(self.scales[ref].at(value), left)

    def down(self, ref: str, value: float) -> float:
        """Px from the top of the same; `y2 domain`: a fraction of the panel."""
        _, top, _, bottom = self.area
        if ref == "paper":
            return bottom - value * (bottom - top)
        name, _, share = ref.partition(" ")
        if share:
            low, high = self.axis(name).domain
            return self.down("paper", low + value * (high - low))
        return _known(self.scales[name].at(value), bottom)

    def labels(self) -> Iterator[str]:
        """Labels and titles of all scales."""
        for name in self.scales:
            axis = self.axis(name)
            other = axis.anchor or ("y" if name.startswith("x") else "x")
            pair = (name, other) if name.startswith("x") else (other, name)
            yield from (_below if name.startswith("x") else _left)(self, name, self.box(pair), axis.tickfont.size)


def frame_of(figure: FigureModel, wide: float, top: float) -> Frame:
    """The frame of a figure that is `wide` px; the legend is above `top`."""
    layout = figure.layout
    traces = [trace for trace in figure.data if isinstance(trace, Flat)]
    pairs = tuple(dict.fromkeys((trace.xaxis, trace.yaxis) for trace in traces))
    names = list(dict.fromkeys(name for pair in pairs for name in pair))
    titled = any(layout.axes[name].title.text for name in names if name.startswith("x"))
    bottom = layout.height - (_LABELS + (_TITLE if titled else 6) + 13 * _lines(traces, wide))
    top = max(top, layout.margin.top if layout.annotations else 0.0)
    scales: dict[str, Scale] = {}
    for name in names:
        if name.startswith("y"):
            low, high = layout.axes[name].domain
            start, end = (bottom - share * (bottom - top) for share in (low, high))
            scales[name] = _scale(layout, traces, name, start, end)
    left = min(_needed(layout, scales, wide), _WIDEST * wide)
    right = wide - max(
        _KEY if any(isinstance(trace, Heatmap) for trace in traces) else 14.0, min(layout.margin.right, 130)
    )
    for name in names:
        if name.startswith("x"):
            low, high = layout.axes[name].domain
            scales[name] = _scale(layout, traces, name, left + low * (right - left), left + high * (right - left))
    return Frame(layout, pairs, scales, (left, top, right, bottom))


def _scale(layout: Layout, traces: Sequence[Flat], name: str, start: float, end: float) -> Scale:
    axis, lies = layout.axes[name], name.startswith("x")
    own = [trace for trace in traces if name in (trace.xaxis, trace.yaxis)]
    values: list[Value] = []
    bars = False
    for trace in own:
        along = trace.x if lies else trace.y
        values += [value for value in along if value is not None]
        bars = bars or (isinstance(trace, Bar) and (trace.orientation == "h") == lies)
        errors = (trace.error_x if lies else trace.error_y) if isinstance(trace, Scatter) else None
        for value, reach in zip(along, errors.array if errors is not None else (), strict=False):
            if value is not None and reach and not isinstance(value, str):
                values += [value - reach, value + reach]
    fields = [trace.x if lies else trace.y for trace in own if isinstance(trace, Heatmap)]
    if axis.range is None and fields:
        axis = axis.model_copy(update={"range": _whole_cells(sorted({*fields[0]}))})
    if bars:
        values.append(0.0)
    return scale_of(axis, values, bars or axis.rangemode == "tozero", start, end)


def _whole_cells(grid: Sequence[float]) -> tuple[float, float]:
    """The range of a map: half a cell beyond its first and its last grid position, so that no cell or mark is cut."""
    if len(grid) < 2:
        return grid[0] - 1.0, grid[0] + 1.0
    return grid[0] - (grid[1] - grid[0]) / 2, grid[-1] + (grid[-1] - grid[-2]) / 2


def _needed(layout: Layout, scales: dict[str, Scale], wide: float) -> float:
    """Px left of the area that are needed so that no label is cut."""
    most = 14.0
    for name, scale in scales.items():
        axis = layout.axes[name]
        beyond = layout.axes[axis.anchor or "x"].domain[0] * 0.9 * wide  # the area begins left of this panel
        labels = max((width(label, 11.5) for _, label in scale.ticks), default=0.0)
        most = max(most, labels + 12 + (_TITLE if axis.title.text else 0) - beyond)
    return most


def _lines(traces: Sequence[Flat], wide: float) -> int:
    """Number of additional lines for the names below a panel."""
    names = list(dict.fromkeys(v for trace in traces for v in trace.x if isinstance(v, str)))
    if not names or max(width(name) for name in names) < 0.8 * wide / len(names):
        return 0
    return max(name.count(", ") for name in names)


def _below(frame: Frame, name: str, box: tuple[float, float, float, float], size: float) -> Iterator[str]:
    left, _, right, bottom = box
    scale = frame.scales[name]
    room = abs(right - left) / max(len(scale.ticks), 1)
    rows = 1
    for place, label in scale.ticks:
        parts = label.split(", ") if scale.names and width(label, size) > 0.9 * room else [label]
        rows = max(rows, len(parts))
        for k, part in enumerate(parts):
            yield text(part, place, bottom + 15 + 13 * k, size=size)
    yield text(frame.axis(name).title.text, (left + right) / 2, bottom + 19 + 13 * rows)


def _left(frame: Frame, name: str, box: tuple[float, float, float, float], size: float) -> Iterator[str]:
    left, top, _, bottom = box
    scale = frame.scales[name]
    room = min(left - 8, _WIDEST * 1000)
    labels = max((width(label, size) for _, label in scale.ticks), default=0.0)
    if scale.names and labels > room:
        size = max(7.0, size * room / labels)
        labels = room
    for place, label in scale.ticks:
        yield text(label, left - 6, place + 0.35 * size, "end", size)
    title = frame.axis(name).title.text
    if title:
        yield text(title, left - labels - 14, (top + bottom) / 2, turned=True)


def _known(place: float | None, other: float) -> float:
    return other if place is None or not math.isfinite(place) else place
