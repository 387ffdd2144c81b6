"""Where the panels of a figure lie, their scales, and the words beside them."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from service.report.drawing import Figure
from service.report.paper.ink import text, width
from service.report.paper.scales import Scale, scale_of

Pair = tuple[str, str]

_TITLE = 20.0  # px beside the labels of a scale
_LABELS = 20.0  # px below a panel
_KEY = 58.0  # px for the key of a map
_WIDEST = 0.42  # of a figure, for the labels left of it


@dataclass(frozen=True)
class Frame:
    """The panels: `pairs` of names of axes (`x`, `y2`), a scale each; `area`: left, top, right, bottom in px."""

    layout: Figure
    pairs: tuple[Pair, ...]
    scales: dict[str, Scale]
    area: tuple[float, float, float, float]

    def axis(self, name: str) -> Figure:
        return axis_of(self.layout, name)

    def box(self, pair: Pair) -> tuple[float, float, float, float]:
        """Left, top, right, bottom of a panel."""
        x, y = (domain(self.axis(name)) for name in pair)
        (left, right), (low, high) = x, y
        return (
            self.across("paper", left),
            self.down("paper", high),
            self.across("paper", right),
            self.down("paper", low),
        )

    def across(self, ref: str, value: float) -> float:
        """Px from the left of a value of an axis, or of a share of the whole area (`paper`)."""
        left, _, right, _ = self.area
        return left + value * (right - left) if ref == "paper" else _known(self.scales[ref].at(value), left)

    def down(self, ref: str, value: float) -> float:
        """Px from above of the same; `y2 domain`: of a share of the panel."""
        _, top, _, bottom = self.area
        if ref == "paper":
            return bottom - value * (bottom - top)
        name, _, share = ref.partition(" ")
        if share:
            low, high = domain(self.axis(name))
            return self.down("paper", low + value * (high - low))
        return _known(self.scales[name].at(value), bottom)

    def labels(self) -> Iterator[str]:
        """Labels and titles of all scales."""
        for name in self.scales:
            axis = self.axis(name)
            size = axis.get("tickfont", {}).get("size", 11.5)
            other = axis.get("anchor", "y" if name.startswith("x") else "x")
            pair = (name, other) if name.startswith("x") else (other, name)
            yield from (_below if name.startswith("x") else _left)(self, name, self.box(pair), size)


def frame_of(figure: Figure, wide: float, top: float) -> Frame:
    """The frame of a figure that is `wide` px; above `top` stands the legend."""
    layout, traces = figure["layout"], figure["data"]
    pairs = tuple(dict.fromkeys((trace.get("xaxis", "x"), trace.get("yaxis", "y")) for trace in traces))
    names = list(dict.fromkeys(name for pair in pairs for name in pair))
    given: Figure = layout["margin"]
    titled = any(_title(axis_of(layout, name)) for name in names if name.startswith("x"))
    bottom = layout["height"] - (_LABELS + (_TITLE if titled else 6) + 13 * _lines(layout, traces, wide))
    top = max(top, given["t"] if layout.get("annotations") else 0.0)
    scales: dict[str, Scale] = {}
    for name in names:
        if name.startswith("y"):
            low, high = domain(axis_of(layout, name))
            start, end = (bottom - share * (bottom - top) for share in (low, high))
            scales[name] = _scale(layout, traces, name, start, end)
    left = min(_needed(layout, scales, wide), _WIDEST * wide)
    right = wide - max(_KEY if any(trace["type"] == "heatmap" for trace in traces) else 14.0, min(given["r"], 70))
    for name in names:
        if name.startswith("x"):
            low, high = domain(axis_of(layout, name))
            scales[name] = _scale(layout, traces, name, left + low * (right - left), left + high * (right - left))
    return Frame(layout, pairs, scales, (left, top, right, bottom))


def axis_of(layout: Figure, name: str) -> Figure:
    """Of the layout, by the name that traces use: `x2` is `xaxis2`."""
    return layout[f"{name[0]}axis{name[1:]}"]


def domain(axis: Figure) -> tuple[float, float]:
    low, high = axis.get("domain", (0.0, 1.0))
    return low, high


def _scale(layout: Figure, traces: Sequence[Figure], name: str, start: float, end: float) -> Scale:
    axis, key = axis_of(layout, name), name[0]
    own = [trace for trace in traces if trace.get(f"{key}axis", key) == name]
    values: list[Any] = []
    bars = False
    for trace in own:
        values += [value for value in trace[key] if value is not None]
        lying = trace.get("orientation") == "h"
        bars = bars or (trace["type"] == "bar" and (key == "x") == lying)
        half: Sequence[float | None] = trace.get(f"error_{key}", {}).get("array", ())
        for value, reach in zip(trace[key], half, strict=False):
            if value is not None and reach and not isinstance(value, str):
                values += [value - reach, value + reach]
    field = any(trace["type"] == "heatmap" for trace in own)
    if field:
        axis = {"range": [min(values), max(values)]} | axis
    if bars:
        values.append(0.0)
    return scale_of(axis, values, bars or axis.get("rangemode") == "tozero", start, end)


def _needed(layout: Figure, scales: dict[str, Scale], wide: float) -> float:
    """Px left of the area, so that no label of a scale is cut."""
    most = 14.0
    for name, scale in scales.items():
        axis = axis_of(layout, name)
        beyond = domain(axis_of(layout, axis.get("anchor", "x")))[0] * 0.9 * wide  # the area begins left of this panel
        labels = max((width(label, 11.5) for _, label in scale.ticks), default=0.0)
        most = max(most, labels + 12 + (_TITLE if _title(axis) else 0) - beyond)
    return most


def _lines(layout: Figure, traces: Sequence[Figure], wide: float) -> int:
    """How many more lines than one the names below a panel take."""
    names = list(dict.fromkeys(v for trace in traces for v in trace.get("x", ()) if isinstance(v, str)))
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
    yield text(_title(frame.axis(name)), (left + right) / 2, bottom + 19 + 13 * rows)


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
    title = _title(frame.axis(name))
    if title:
        yield text(title, left - labels - 14, (top + bottom) / 2, turned=True)


def _title(axis: Figure) -> str:
    return axis.get("title", {}).get("text", "")


def _known(place: float | None, other: float) -> float:
    return other if place is None or not math.isfinite(place) else place
