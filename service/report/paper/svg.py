"""SVG elements as text: lines, words, markers."""

import math
from collections.abc import Iterable, Sequence
from html import escape

Point = tuple[float, float]

FONT = 12.0  # px
TEXT, AXIS = "#334155", "#94a3b8"
_WIDE = 0.56  # mean width of a letter over its size


def element(name: str, content: str = "", /, **attributes: str | float | None) -> str:
    """An element; `_` in names of attributes becomes `-`, None omits one. `content` is markup."""
    written = "".join(
        f' {key.replace("_", "-")}="{escape(value) if isinstance(value, str) else f"{value:.5g}"}"'
        for key, value in attributes.items()
        if value is not None
    )
    return f"<{name}{written}>{content}</{name}>"


def path(parts: Iterable[Sequence[Point]], **attributes: str | float | None) -> str:
    """Polylines as one element; an empty string if there is nothing to draw."""
    drawn = "".join(
        "M" + "L".join(f"{x:.2f} {y:.2f}" for x, y in part) for part in parts if len(part) > 1
    )  # two decimals of a px: finer than a printer dot
    return element("path", d=drawn, **({"fill": "none"} | attributes)) if drawn else ""


def text(
    words: str,
    x: float,
    y: float,
    anchor: str = "middle",
    size: float = FONT,
    colour: str = TEXT,
    turned: bool = False,
) -> str:
    """Text on its base line; `turned`: vertical, from bottom to top."""
    return element(
        "text",
        escape(words),
        x=x,
        y=y,
        font_size=size,
        fill=colour,
        text_anchor=anchor,
        transform=f"rotate(-90 {x:.2f} {y:.2f})" if turned else None,
    )


def width(words: str, size: float = FONT) -> float:
    """Approximate width of text in px."""
    return _WIDE * size * len(words)


def marker(symbol: str, at: Point, size: float, colour: str) -> str:
    """A marker of `size` px; those that end with `open` are outlines."""
    x, y = at
    half = size / 2
    if symbol.startswith("line-ew"):
        return path([[(x - half, y), (x + half, y)]], stroke=colour, stroke_width=2.5)
    if symbol.startswith("x"):
        corners = [[(x - half, y - half), (x + half, y + half)], [(x - half, y + half), (x + half, y - half)]]
        return path(corners, stroke=colour, stroke_width=1.4)
    hollow = symbol.endswith("open")
    look: dict[str, str | float | None] = {
        "fill": "none" if hollow else colour,
        "stroke": colour if hollow else "white",
        "stroke_width": 1.4 if hollow else 0.5,
    }
    kind = symbol.removesuffix("-open")
    if kind not in _CORNERS:
        return element("circle", cx=x, cy=y, r=half, **look)
    places = [(x + half * r * math.sin(angle), y - half * r * math.cos(angle)) for r, angle in _CORNERS[kind]]
    return element("polygon", points=" ".join(f"{a:.2f},{b:.2f}" for a, b in places), **look)


def _regular(corners: int, first: float = 0.0, reach: float = 1.15) -> list[Point]:
    return [(reach, first + 2 * math.pi * k / corners) for k in range(corners)]


_CORNERS: dict[str, list[Point]] = {
    "square": _regular(4, math.pi / 4, 1.3),
    "diamond": _regular(4, 0.0, 1.3),
    "triangle-up": _regular(3, 0.0, 1.3),
    "hexagon2": _regular(6),
    "star": [(1.5 if k % 2 == 0 else 0.6, math.pi * k / 5) for k in range(10)],
}
"""Distance from the centre, in halves of the size, and angle from the top."""
