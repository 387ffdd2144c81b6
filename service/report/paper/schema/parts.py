"""Common parts of traces and layouts. Names are those of plotly.js; defaults are the report's."""

from typing import Literal

from pydantic import BaseModel, ConfigDict

SIZE = 12.0  # px, of letters
DARK = "#334155"


class Drawing(BaseModel):
    """A part of a figure's description: immutable, without undefined keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Font(Drawing):
    """Letters; `size` in px."""

    family: str = "sans-serif"
    size: float = SIZE
    color: str = DARK


class Words(Drawing):
    """A title; `standoff`: px from its element, on the screen."""

    text: str
    standoff: float = 0.0


class Stroke(Drawing):
    """A line; `width` in px."""

    color: str = DARK
    width: float = 1.8
    dash: Literal["solid", "dash", "dot"] = "solid"
