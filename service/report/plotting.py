"""Draws a figure, described in the words of plotly.js, with matplotlib: as SVG in a page and on paper.

The diagnosis page of the service draws the same descriptions with plotly.js. A description outside of the words
that are read here is an error (KeyError), not a figure with something missing.
"""

# matplotlib leaves the types of its keywords open
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

import re
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from io import StringIO
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from service.model import Array
from service.report.drawing import GRID, DrawnFigure

WIDTH, PAPER_WIDTH = 960.0, 680.0  # px: of a page, and of A4 between its margins
_PX = 72.0  # dots per inch: one point is one px
_DARK, _LINE = "#334155", "#94a3b8"
_LOOK: Any = {
    "font.family": "sans-serif",
    "font.size": 12.0,
    "text.color": _DARK,
    "axes.labelcolor": _DARK,
    "axes.edgecolor": _LINE,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "hatch.color": "white",
    "hatch.linewidth": 1.6,
    "xtick.color": _LINE,
    "ytick.color": _LINE,
    "xtick.labelcolor": _DARK,
    "ytick.labelcolor": _DARK,
    "legend.frameon": False,
    "path.simplify_threshold": 0.5,
    "svg.fonttype": "none",  # words are searched, and read aloud
    "svg.hashsalt": "sweepid",  # equal figures give equal files
}
_DASHES = {"dash": (0, (6, 4)), "dot": (0, (1.5, 3))}

Words = Mapping[str, Any]


def svg(figure: DrawnFigure, title: str, width: float = WIDTH) -> str:
    """The element `svg` of a figure, at least `width` px wide; `title`: for readers who do not see it."""
    buffer = StringIO()
    with rc_context(_LOOK):
        drawn(figure, width).savefig(buffer, format="svg", dpi=200, metadata={"Date": None})
    text = buffer.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r'<g id="\w+_\d+">', "<g>", text)  # the same names in every figure of a page
    text = re.sub(r"font: (?:(bold) )?([\d.]+px) [^;\"]*", r"font-size: \2; font-family: sans-serif", text)
    start = f'<svg role="img" aria-label="{escape(title)}" '
    return start + re.sub(r' (?:width|height)="[\d.]+pt"', "", text.removeprefix("<svg "), count=2)


def drawn(figure: DrawnFigure, width: float = WIDTH) -> Canvas:
    """The figure, 72 dots per inch; `width` px, or more if it needs them."""
    layout: Words = figure["layout"]
    wide = max(width, layout.get("meta", {}).get("width", 0.0))
    high = layout["height"] * (wide / WIDTH) ** 0.5  # flatter where there is less room
    canvas = Canvas(figsize=(wide / _PX, high / _PX), dpi=_PX)
    traces: Sequence[Words] = figure["data"]
    panels = _Panels(canvas, traces, layout)
    patterns = dict(_patterns(traces))
    for pair in panels.axes:
        own = [trace for trace in traces if _pair(trace) == pair]
        bars = [trace for trace in own if trace.get("type") == "bar" and _has_values(trace)]
        before: Array | None = None
        for trace in own:
            x, y = (panels.places(name, trace[kind]) for name, kind in zip(pair, "xy", strict=True))
            match trace.get("type", "scatter"):
                case "bar":
                    _bars(panels.axes[pair], trace, x, y, bars, layout)
                case "heatmap":
                    _field(canvas, panels.axes[pair], trace, x, y)
                case "contour":
                    _levels(panels.axes[pair], trace, x, y)
                case "scatter" if trace["mode"] == "lines":
                    _curve(panels.axes[pair], trace, x, y, before, patterns)
                    before = y
                case "scatter":
                    _points(panels.axes[pair], trace, x, y)
                case unknown:
                    raise KeyError(unknown)
    panels.set_scales()
    for shape in layout.get("shapes", ()):
        panels.shape(shape)
    panels.arrange([_key(trace, patterns) for trace in traces if _is_named(trace, layout)])
    return canvas


class _Panels:
    """The areas of a figure, each between two scales, and what lies between and around them."""

    edge = 6.0  # px around everything

    def __init__(self, canvas: Canvas, traces: Sequence[Words], layout: Words) -> None:
        self._canvas, self._layout = canvas, layout
        self._names: dict[str, list[str]] = {}  # of the categories of a scale
        self.axes: dict[tuple[str, str], Axes] = {}
        for trace in traces:
            pair = _pair(trace)
            if pair not in self.axes:
                shared = next((axes for (x, _), axes in self.axes.items() if x == pair[0]), None)
                self.axes[pair] = canvas.add_axes((0.1, 0.1, 0.8, 0.8), sharex=shared, label=str(pair))
        notes = layout.get("annotations", ())
        self._notes = [(note, self._write(note)) for note in notes]

    def places(self, name: str, values: Sequence[Any]) -> Array:
        """Numbers, NaN for what is missing; categories by their order."""
        names = self._names.setdefault(name, [])
        names += [value for value in dict.fromkeys(values) if isinstance(value, str) and value not in names]
        return np.array([names.index(v) if isinstance(v, str) else np.nan if v is None else v for v in values], float)

    def set_scales(self) -> None:
        for (x, y), axes in self.axes.items():
            axes.margins(0.02, 0.06)
            for name, anchor, which in ((x, y, "x"), (y, x, "y")):
                words = self._words(name)
                default = "y" if which == "x" else "x"
                _set_scale(axes, which, words, self._names[name], words.get("anchor", default) == anchor)

    def shape(self, shape: Words) -> None:
        """A line across a panel, or an area between two places of a scale."""
        for (x, y), axes in self.axes.items():
            if shape["xref"] != x or shape["yref"] not in ("paper", f"{y} domain"):
                continue
            low, high = axes.get_xlim()
            if shape["type"] == "rect":
                axes.axvspan(shape["x0"], shape["x1"], color=shape["fillcolor"], linewidth=0, zorder=0)
            elif min(low, high) <= shape["x0"] <= max(low, high):
                line = shape["line"]
                axes.axvline(shape["x0"], color=line["color"], linewidth=line["width"], linestyle=_DASHES[line["dash"]])
            axes.set_xlim(low, high)

    def arrange(self, keys: Sequence[Artist]) -> None:
        """The legend on top, in as many lines as it needs; then as much room for the panels as their words leave."""
        wide, high = self._canvas.get_size_inches() * _PX
        top = _Panels.edge
        for columns in range(len(keys), 0, -1):
            legend = self._canvas.legend(
                handles=keys, loc="upper left", bbox_to_anchor=(0, 1), ncols=columns, borderpad=0.2, columnspacing=1.4
            )
            box = legend.get_window_extent()
            if box.width <= wide or columns == 1:
                top += box.height + 4
                break
            legend.remove()
        left = right = bottom = _Panels.edge
        for _ in range(2):  # other room gives other labels
            self._place(left / wide, bottom / high, 1 - right / wide, 1 - top / high)
            boxes = [axes.get_tightbbox() for axes in self.axes.values()]
            boxes += [text.get_window_extent() for _, text in self._notes]
            found = [box for box in boxes if box is not None]
            left += max(0.0, _Panels.edge - min(box.x0 for box in found))
            bottom += max(0.0, _Panels.edge - min(box.y0 for box in found))
            right += max(0.0, max(box.x1 for box in found) - wide + _Panels.edge)
            top += max(0.0, max(box.y1 for box in found) - high + top)
        self._place(left / wide, bottom / high, 1 - right / wide, 1 - top / high)

    def _place(self, left: float, bottom: float, right: float, top: float) -> None:
        for (x, y), axes in self.axes.items():
            (x0, x1), (y0, y1) = (self._words(name).get("domain", (0.0, 1.0)) for name in (x, y))
            across, up = right - left, top - bottom
            axes.set_position((left + x0 * across, bottom + y0 * up, (x1 - x0) * across, (y1 - y0) * up))
        for note, text in self._notes:
            lift = note.get("yshift", 0.0) / (self._canvas.get_size_inches()[1] * _PX)
            text.set_position((left + note["x"] * (right - left), bottom + note["y"] * (top - bottom) + lift))

    def _write(self, note: Words) -> Any:
        size = min(note["font"]["size"], 12)
        return self._canvas.text(0, 0, _plain(note["text"]), size=size, ha=note["xanchor"], va=note["yanchor"])

    def _words(self, name: str) -> Words:
        return self._layout[f"{name[0]}axis{name[1:]}"]


def _set_scale(axes: Axes, which: str, words: Words, names: Sequence[str], labelled: bool) -> None:
    """`labelled`: this panel bears the labels of the scale, which others may share."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    kind = words.get("type", "linear")
    if kind == "log":
        (axes.set_xscale if which == "x" else axes.set_yscale)("log")
        axes.minorticks_off()
        axis.set_major_formatter(_power)  # matplotlib's own would parse a formula for each label
    set_limits, low_high = (axes.set_xlim, axes.get_xlim()) if which == "x" else (axes.set_ylim, axes.get_ylim())
    if names:
        axis.set_ticks(range(len(names)), [_plain(name) for name in names])
        set_limits(-0.5, len(names) - 0.5)
    elif "tickvals" in words:
        values = words["tickvals"]
        axis.set_ticks(values, words.get("ticktext", [f"{value:g}" for value in values]))
        set_limits(*low_high)
    elif kind == "linear":
        axis.set_major_locator(MaxNLocator(words.get("nticks", 8), steps=[1, 2, 5, 10]))
    if "range" in words:
        set_limits(*(10**end if kind == "log" else end for end in words["range"]))
    if words.get("rangemode") == "tozero":
        set_limits(0.0, low_high[1])
    if words.get("autorange") == "reversed":
        axis.set_inverted(True)
    if words.get("zeroline"):
        (axes.axvline if which == "x" else axes.axhline)(0.0, color="#64748b", linewidth=0.8, zorder=1)
    if words.get("showgrid", True):
        axis.grid(True, linewidth=0.8)
    axis.set_tick_params(
        labelsize=words.get("tickfont", {}).get("size", 11.5), labelbottom=labelled, labelleft=labelled
    )
    if labelled:
        axis.set_label_text(_plain(words["title"]["text"]))


def _power(value: float, _: object) -> str:
    """A power of ten, with its exponent raised."""
    return f"10{str(round(np.log10(value))).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))}"


def _curve(
    axes: Axes,
    trace: Words,
    x: Array,
    y: Array,
    before: Array | None,
    patterns: Mapping[str, Any],
) -> None:
    if trace.get("fill") == "tonexty" and before is not None:
        axes.fill_between(x, before, y, color=trace["fillcolor"], linewidth=0)
    line = trace["line"]
    if line["width"] > 0:
        axes.plot(x, y, color=line["color"], linewidth=0.85 * line["width"], linestyle=_dash(line, patterns))


def _points(axes: Axes, trace: Words, x: Array, y: Array) -> None:
    for kind in ("x", "y"):
        if (error := trace.get(f"error_{kind}")) is not None:
            half = {f"{kind}err": [0.0 if value is None else value for value in error["array"]]}
            look = {"ecolor": error["color"], "elinewidth": error["thickness"], "capsize": error["width"]}
            axes.errorbar(x, y, **half, **look, fmt="none", zorder=2)
    marker = trace["marker"]
    if "colorscale" not in marker:
        axes.plot(x, y, linestyle="none", zorder=3, clip_on=trace.get("cliponaxis", True), **_marker(marker))
        return
    axes.scatter(
        x,
        y,
        c=marker["color"],
        cmap=_colours(marker["colorscale"]),
        vmin=marker["cmin"],
        vmax=marker["cmax"],
        s=marker["size"] ** 2,
        edgecolors=marker["line"]["color"],
        linewidths=marker["line"]["width"],
        zorder=3,
    )


def _bars(axes: Axes, trace: Words, x: Array, y: Array, bars: Sequence[Words], layout: Words) -> None:
    if trace not in bars:
        return
    width, beside = trace.get("width", 0.8), 0.0
    if layout.get("barmode", "group") == "group":
        width = (1 - layout.get("bargap", 0.2)) / len(bars)
        beside = (next(k for k, other in enumerate(bars) if other is trace) - (len(bars) - 1) / 2) * width
    across = trace.get("orientation") == "h"
    draw, places, sizes = (axes.barh, y, x) if across else (axes.bar, x, y)
    drawn = draw(places + beside, sizes, width, color=trace["marker"]["color"], hatch=_hatch(trace))
    if "text" in trace:
        axes.bar_label(drawn, trace["text"], padding=3, fontsize=11.5)


def _field(canvas: Canvas, axes: Axes, trace: Words, x: Array, y: Array) -> None:
    field = axes.pcolormesh(
        x,
        y,
        _matrix(trace["z"]),
        shading="nearest",
        rasterized=True,
        cmap=_colours(trace["colorscale"]),
        vmin=trace["zmin"],
        vmax=trace["zmax"],
    )
    key = axes.inset_axes((1.02, 0.0, 0.014, 1.0))
    canvas.colorbar(field, cax=key)
    key.set_title(_plain(trace["colorbar"]["title"]["text"]), size=12, loc="left")


def _levels(axes: Axes, trace: Words, x: Array, y: Array) -> None:
    if len(x) > 1 and len(y) > 1:
        drawn = axes.contour(
            x, y, _matrix(trace["z"]), trace["ncontours"], colors=trace["line"]["color"], linewidths=0.8
        )
        axes.clabel(drawn, fontsize=11, colors="#0f172a")


def _key(trace: Words, patterns: Mapping[str, Any]) -> Artist:
    """The entry of a trace in the legend."""
    name = _plain(trace["name"])
    if trace.get("type") == "bar":
        colour = trace["marker"]["color"]
        colour = colour if isinstance(colour, str) else colour[0]
        return Patch(facecolor=colour, hatch=_hatch(trace), label=name)
    if trace["mode"] == "lines":
        line = trace["line"]
        return Line2D([], [], color=line["color"], linewidth=line["width"], linestyle=_dash(line, patterns), label=name)
    marker = trace["marker"]
    if "colorscale" in marker:
        marker = {**marker, "color": marker["colorscale"][-1][1]}
    return Line2D([], [], linestyle="none", label=name, **_marker({**marker, "size": min(marker["size"], 20)}))


def _is_named(trace: Words, layout: Words) -> bool:
    return bool(layout.get("showlegend", True) and trace.get("name") and trace.get("showlegend", True))


def _patterns(traces: Sequence[Words]) -> Iterator[tuple[str, Any]]:
    """A pattern for each colour of solid lines that share a panel: colours alone are lost in grey print."""
    patterns = ("-", (0, (7, 3)), (0, (2, 2.5)), (0, (9, 3, 2, 3)), (0, (4, 2)), (0, (1.5, 4)))
    panels: dict[tuple[str, str], dict[str, None]] = {}
    for trace in traces:
        if trace.get("mode") == "lines" and trace["line"]["width"] > 0 and _is_solid(trace["line"]):
            panels.setdefault(_pair(trace), {})[trace["line"]["color"]] = None
    for colours in panels.values():
        yield from zip(colours, patterns, strict=False)


def _dash(line: Words, patterns: Mapping[str, Any]) -> Any:
    return patterns.get(line["color"], "-") if _is_solid(line) else _DASHES[line["dash"]]


def _is_solid(line: Words) -> bool:
    return line.get("dash", "solid") == "solid"


def _marker(marker: Words) -> Words:
    markers = {
        "circle": "o",
        "square": "s",
        "triangle-up": "^",
        "diamond": "D",
        "star": "*",
        "hexagon2": "h",
        "x-thin": "x",
        "line-ew": "_",
    }
    symbol, is_open, _ = marker.get("symbol", "circle").partition("-open")
    edge = marker.get("line") or {"color": marker["color"], "width": 0.0}
    return {
        "marker": markers[symbol],
        "markersize": marker["size"],
        "markerfacecolor": "none" if is_open else marker["color"],
        "markeredgecolor": edge["color"],
        "markeredgewidth": edge["width"],
    }


def _hatch(trace: Words) -> str | None:
    return "///" if trace["marker"].get("pattern", {}).get("shape") == "/" else None


def _colours(scale: Sequence[tuple[float, str]]) -> LinearSegmentedColormap:
    return LinearSegmentedColormap.from_list("", [(place, colour) for place, colour in scale])


def _matrix(rows: Sequence[Sequence[float | None]]) -> Array:
    return np.array([[np.nan if value is None else value for value in row] for row in rows], float)


def _pair(trace: Words) -> tuple[str, str]:
    return trace.get("xaxis", "x"), trace.get("yaxis", "y")


def _has_values(trace: Words) -> bool:
    return any(value is not None for value in trace["x"])


def _plain(text: str) -> str:
    """matplotlib would read what is between dollars as a formula."""
    return text.replace("$", r"\$")
