"""The legend above a figure, in the necessary number of lines; curves differ not only in colour."""

from collections.abc import Iterator, Mapping, Sequence

from service.report.paper.marks import DASHES, HATCHED, rectangle
from service.report.paper.schema import Bar, Contour, FigureModel, Heatmap, Scatter, Scatter3d, Surface, Trace
from service.report.paper.svg import marker, path, text, width

LINE = 18.0  # px
_SWATCH = 28.0
_PATTERNS = (None, "7 3", "2 2.5", "9 3 2 3", "4 2", "1.5 4")

Entry = tuple[float, int, Trace]


def dashes(traces: Sequence[Trace]) -> Mapping[str, str | None]:
    """A dash pattern for each colour of solid lines, if lines of several colours share a panel."""
    panels: dict[str, dict[str, None]] = {}
    for trace in traces:
        if isinstance(trace, Scatter) and trace.mode == "lines":
            line = trace.line
            if line.width > 0 and line.dash == "solid":
                panels.setdefault(trace.yaxis, {})[line.color] = None
    found: dict[str, str | None] = {}
    for colours in panels.values():
        for k, colour in enumerate(colours if len(colours) > 1 else ()):
            found.setdefault(colour, _PATTERNS[k % len(_PATTERNS)])
    return found


def dash_of(trace: Scatter, patterns: Mapping[str, str | None]) -> str | None:
    """The pattern of a curve."""
    line = trace.line
    return patterns.get(line.color) if line.dash == "solid" else DASHES[line.dash]


def entries(figure: FigureModel, wide: float) -> list[Entry]:
    """Left and line (from 0) of each trace with a visible name."""
    if not figure.layout.showlegend:
        return []
    placed: list[Entry] = []
    left, row = 0.0, 0
    for trace in figure.data:
        if not trace.name or not trace.showlegend:
            continue
        space = _SWATCH + width(trace.name) + 22
        if left > 0 and left + space > wide:
            left, row = 0.0, row + 1
        placed.append((left, row, trace))
        left += space
    return placed


def drawn(placed: Sequence[Entry], left: float, patterns: Mapping[str, str | None]) -> Iterator[str]:
    """The legend, from `left` px on, at the top of the figure."""
    for offset, row, trace in placed:
        x, y = left + offset, 11 + LINE * row
        yield from _swatch(trace, x, y, patterns)
        yield text(trace.name, x + _SWATCH + 4, y + 4, "start")


def _swatch(trace: Trace, x: float, y: float, patterns: Mapping[str, str | None]) -> Iterator[str]:
    match trace:
        case Bar(marker=look):
            yield _patch(look.color if isinstance(look.color, str) else look.color[0], x, y)
            if look.pattern.shape:
                yield _patch(HATCHED, x, y)
        case Surface():
            yield _patch(trace.colorscale[-1][1], x, y)
        case Scatter(mode="lines", line=line):
            yield path(
                [[(x, y), (x + _SWATCH, y)]],
                stroke=line.color,
                stroke_width=line.width,
                stroke_dasharray=dash_of(trace, patterns),
            )
        case Scatter(marker=look) | Scatter3d(marker=look):
            yield marker(look.symbol, (x + _SWATCH / 2, y), min(1.1 * look.size, 20), look.color)
        case Heatmap() | Contour():
            pass  # a map has its key next to it


def _patch(colour: str, x: float, y: float) -> str:
    return rectangle((x + 4, y - 6, 20, 11), colour)
