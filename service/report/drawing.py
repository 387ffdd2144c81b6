"""Elements of the figures: colours, lines, points, scales, in the format of plotly.js."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import cycle
from typing import TypedDict, TypeVar

import numpy as np

from service.model import Array, Robot

T = TypeVar("T")
Drawn = str | float | None | Sequence["Drawn"] | Mapping[str, "Drawn"]  # accepted by plotly.js
Part = Mapping[str, Drawn]  # a trace, a scale, an annotation

MEASURED, IDENTIFIED, REFERENCE, PAPER = "#c2410c", "#1d4ed8", "#94a3b8", "#7c3aed"
_COLOURS = ("#1d4ed8", "#0f766e", "#b45309", "#7c3aed", "#be123c", "#475569")
GRID = "#e2e8f0"
DECADES = {"type": "log", "dtick": 1, "exponentformat": "power"}


class DrawnFigure(TypedDict):
    """A figure for plotly.js; the layout has a "height", px."""

    data: Sequence[Part]
    layout: Part


def line(name: str, x: Drawn, y: Array, colour: str, dash: str = "solid", width: float = 1.8) -> Part:
    """A curve."""
    style = {"color": colour, "dash": dash, "width": width}
    return {"type": "scatter", "mode": "lines", "name": name, "x": x, "y": rounded(y), "line": style}


def points(
    name: str, x: Drawn, y: Array, colour: str, error: Array | None = None, symbol: str = "circle", size: float = 7
) -> Part:
    """Markers, with error bars of half length `error` where given."""
    marker: dict[str, Drawn] = {"size": size, "color": colour, "symbol": symbol}
    if symbol.endswith("open"):
        marker["line"] = {"width": 1.8, "color": colour}
    trace: dict[str, Drawn] = {"type": "scatter", "mode": "markers", "name": name, "x": x, "y": rounded(y)}
    trace["marker"] = marker
    if error is not None:
        trace["error_y"] = {"array": rounded(error), "color": colour, "thickness": 1.1, "width": 3}
    return trace


def figure(traces: Sequence[Part], layout: Part) -> DrawnFigure:
    """Traces and layout in the report's look."""
    base: Part = {
        "font": {"family": "system-ui, sans-serif", "size": 13, "color": "#334155"},
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "margin": {"l": 70, "r": 20, "t": 20, "b": 55},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        "hoverlabel": {"font": {"family": "system-ui, sans-serif"}},
    }
    return {"data": traces, "layout": {**base, **layout}}


def scale(title: str, zeroline: bool = False) -> Part:
    """An axis of a figure."""
    return {
        "title": {"text": title, "standoff": 8},
        "gridcolor": GRID,
        "zeroline": zeroline,
        "zerolinecolor": "#64748b",
        "linecolor": "#94a3b8",
        "showline": True,
        "ticks": "outside",
        "tickcolor": "#94a3b8",
        "automargin": True,
    }


def looks(things: Iterable[T]) -> Iterator[tuple[T, str, str]]:
    """Each axis or robot with its colour and marker: colours alone cannot be distinguished in grey print or by
    colour-blind readers.
    """
    symbols = ("circle", "square", "triangle-up", "diamond", "star", "hexagon2")
    return zip(things, cycle(_COLOURS), cycle(symbols), strict=False)


def panels(count: int, columns: int = 3) -> Iterator[tuple[Part, float, float, float, float]]:
    """The keys of the axes of each panel, its left and top edge, width and height, 0 ... 1; in rows from the top."""
    rows = -(-count // columns)
    for k in range(count):
        row, column = divmod(k, columns)
        number = "" if k == 0 else str(k + 1)
        yield {"xaxis": f"x{number}", "yaxis": f"y{number}"}, column / columns, 1 - row / rows, 1 / columns, 1 / rows


def note(text: str, left: float, top: float, **more: Drawn) -> Part:
    """Words at a place of the figure, 0 ... 1 from its lower left corner; they stand on it, to its right."""
    words: Part = {
        "text": text,
        "x": left,
        "y": top,
        "xref": "paper",
        "yref": "paper",
        "xanchor": "left",
        "yanchor": "bottom",
        "yshift": 0,
        "showarrow": False,
        "font": {"size": 12},
    }
    return {**words, **more}


def upright(panel: str, place: float, colour: str, width: float = 1.5, dash: str = "dash") -> Part:
    """A line across a panel; `panel`: the number behind the names of its axes, "" for the first."""
    return {
        "type": "line",
        "xref": f"x{panel}",
        "yref": f"y{panel} domain",
        "x0": place,
        "x1": place,
        "y0": 0,
        "y1": 1,
        "line": {"color": colour, "width": width, "dash": dash},
    }


def degrees(angles: Array) -> list[float]:
    """Angles in degrees."""
    return [round(math.degrees(angle), 3) for angle in angles]


def slides(robot: Robot, number: int) -> bool:
    """Whether joint `number` is prismatic: its positions are m, its efforts N, its inertia kg."""
    return robot.chain.joints[number].kind == "prismatic"


def positions(robot: Robot, number: int, values: Array) -> list[float]:
    """Positions (rad, m) of joint `number` in deg or mm."""
    return [round(1e3 * float(value), 3) for value in values] if slides(robot, number) else degrees(values)


def position_title(robot: Robot, number: int) -> str:
    """Title of an axis of a figure with positions of joint `number`."""
    return f"{robot.joints[number]} in {'mm' if slides(robot, number) else 'deg'}"


def rounded(values: Array, decimals: int | None = None) -> list[Drawn]:
    """Nested lists with 6 significant digits (or `decimals` decimals); None for NaN, which JSON does not have."""
    values = np.asarray(values, dtype=float)
    if values.ndim > 1:
        return [rounded(row, decimals) for row in values]
    if decimals is not None:
        return [round(float(value), decimals) for value in values]
    return [float(f"{value:.6g}") if np.isfinite(value) else None for value in values]
