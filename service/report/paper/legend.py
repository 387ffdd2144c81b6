"""What stands for what, above a figure, in as many lines as it takes; lines differ by more than their colour."""

from collections.abc import Iterator, Mapping, Sequence

from service.report.drawing import Figure
from service.report.paper.ink import marker, path, text, width
from service.report.paper.marks import DASHES, HATCHED, rectangle

LINE = 18.0  # px
_SWATCH = 28.0
_PATTERNS = (None, "7 3", "2 2.5", "9 3 2 3", "4 2", "1.5 4")


def dashes(traces: Sequence[Figure]) -> Mapping[str, str | None]:
    """For each colour of whole lines a pattern, where lines of several colours share a panel."""
    panels: dict[str, dict[str, None]] = {}
    for trace in traces:
        line: Figure = trace.get("line", {})
        if "lines" in trace.get("mode", "") and line.get("width", 1.8) > 0 and line.get("dash", "solid") == "solid":
            panels.setdefault(trace.get("yaxis", "y"), {})[line["color"]] = None
    found: dict[str, str | None] = {}
    for colours in panels.values():
        for k, colour in enumerate(colours if len(colours) > 1 else ()):
            found.setdefault(colour, _PATTERNS[k % len(_PATTERNS)])
    return found


def dash_of(trace: Figure, patterns: Mapping[str, str | None]) -> str | None:
    """The pattern of a curve."""
    line: Figure = trace.get("line", {})
    dash = line.get("dash", "solid")
    return patterns.get(line.get("color", "")) if dash == "solid" else DASHES[dash]


def entries(figure: Figure, wide: float) -> list[tuple[float, float, Figure]]:
    """Left and line (from 0) of each trace that has a name to show."""
    if figure["layout"].get("showlegend") is False:
        return []
    placed: list[tuple[float, float, Figure]] = []
    left, row = 0.0, 0
    for trace in figure["data"]:
        if not trace.get("name") or trace.get("showlegend") is False:
            continue
        space = _SWATCH + width(trace["name"]) + 22
        if left > 0 and left + space > wide:
            left, row = 0.0, row + 1
        placed.append((left, row, trace))
        left += space
    return placed


def drawn(
    placed: Sequence[tuple[float, float, Figure]], left: float, patterns: Mapping[str, str | None]
) -> Iterator[str]:
    """The legend, from `left` px on, at the top of the figure."""
    for offset, row, trace in placed:
        x, y = left + offset, 11 + LINE * row
        yield from _swatch(trace, x, y, patterns)
        yield text(trace["name"], x + _SWATCH + 4, y + 4, "start")


def _swatch(trace: Figure, x: float, y: float, patterns: Mapping[str, str | None]) -> Iterator[str]:
    look: Figure = trace.get("marker", {})
    middle = (x + _SWATCH / 2, y)
    if trace["type"] in ("bar", "surface"):
        colour = look["color"] if trace["type"] == "bar" else trace["colorscale"][-1][1]
        yield rectangle((x + 4, y - 6, 20, 11), colour if isinstance(colour, str) else colour[0])
        if look.get("pattern", {}).get("shape"):
            yield rectangle((x + 4, y - 6, 20, 11), HATCHED)
    elif "lines" in trace["mode"]:
        line: Figure = trace["line"]
        yield path(
            [[(x, y), (x + _SWATCH, y)]],
            stroke=line["color"],
            stroke_width=line.get("width", 1.8),
            stroke_dasharray=dash_of(trace, patterns),
        )
    if "markers" in trace.get("mode", ""):
        yield marker(look.get("symbol", "circle"), middle, min(1.1 * look["size"], 20), look["color"])
