"""Surfaces over two joints with points, in the view of the screen: the far faces are drawn first."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from service.report.paper.maps import blend
from service.report.paper.scales import round_steps, tick_label
from service.report.paper.schema import Scatter3d, Scene, Surface, Trace
from service.report.paper.svg import AXIS, element, marker, path, text

Array = NDArray[np.float64]
Spatial = Surface | Scatter3d

_GRID = "#e2e8f0"


def surfaces(traces: Sequence[Trace], scene: Scene, wide: float, top: float, high: float) -> str:
    """The drawing between `top` and `high` px, without its legend."""
    inside = [trace for trace in traces if isinstance(trace, (Surface, Scatter3d))]
    view = _View(inside, scene, wide, top, high)
    drawn: list[tuple[float, str]] = []
    for trace in inside:
        drawn += _faces(trace, view) if isinstance(trace, Surface) else _points(trace, view)
    drawn.sort(key=lambda part: part[0])
    return "".join((*_box(scene, view), *(part for _, part in drawn)))


class _View:
    """Parallel projection from the camera of the figure, as large as fits."""

    def __init__(self, traces: Sequence[Spatial], scene: Scene, wide: float, top: float, high: float) -> None:
        self.low, self.high = _bounds(traces)
        ratio, eye = (np.array([place.x, place.y, place.z]) for place in (scene.aspectratio, scene.camera.eye))
        self._size = ratio
        ahead = -eye / np.linalg.norm(eye)
        right = np.cross(ahead, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        self._axes = np.array([right, -np.cross(right, ahead), -ahead])  # right, down, towards the eye
        self._middle, self._scale, self._centre = np.zeros(2), 1.0, np.zeros(2)
        ends = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
        flat = np.array([self.at(self.corner(end))[0] for end in ends])
        reach = np.ptp(flat, axis=0)
        self._scale = min((wide - 150) / reach[0], (high - top - 70) / reach[1])
        self._centre = (flat.max(axis=0) + flat.min(axis=0)) / 2
        self._middle = np.array([wide / 2, (top + high) / 2 - 8])

    def corner(self, end: Sequence[float]) -> Array:
        """A corner of the box, or a point on its edges: coordinates 0 ... 1."""
        return self.low + np.array(end, dtype=float) * (self.high - self.low)

    def at(self, point: Array) -> tuple[Array, float]:
        """Px (2,), and the depth (larger is nearer)."""
        seen = self._axes @ (((point - self.low) / (self.high - self.low) - 0.5) * self._size)
        return self._middle + self._scale * (seen[:2] - self._centre), float(seen[2])


def _bounds(traces: Sequence[Spatial]) -> tuple[Array, Array]:
    ends: list[tuple[float, float]] = []
    for along in zip(*(_places(trace) for trace in traces), strict=True):
        found = np.concatenate([values.ravel() for values in along])
        low, high = float(np.nanmin(found)), float(np.nanmax(found))
        room = 0.04 * (high - low) or 0.5
        ends.append((low - room, high + room))
    bounds = np.array(ends)
    return bounds[:, 0], bounds[:, 1]


def _places(trace: Spatial) -> tuple[Array, Array, Array]:
    x, y, z = (np.asarray(values, dtype=float) for values in (trace.x, trace.y, trace.z))
    return x, y, z


def _faces(trace: Surface, view: _View) -> Iterator[tuple[float, str]]:
    """Faces between four grid points that all have a value. A transparent surface is also dashed."""
    x, y, z = _places(trace)
    low, high = float(np.nanmin(z)), float(np.nanmax(z))
    faint = trace.opacity < 0.6
    for j in range(len(y) - 1):
        for i in range(len(x) - 1):
            corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
            values = np.array([z[b, a] for a, b in corners])
            if not np.isfinite(values).all():
                continue
            seen = [view.at(np.array([x[a], y[b], z[b, a]])) for a, b in corners]
            share = (float(values.mean()) - low) / ((high - low) or 1.0)
            yield (
                sum(near for _, near in seen) / 4,
                element(
                    "polygon",
                    points=" ".join(f"{px:.2f},{py:.2f}" for (px, py), _ in seen),
                    fill=blend(trace.colorscale, share),
                    fill_opacity=trace.opacity,
                    stroke="#475569" if faint else "#1e3a8a",
                    stroke_width=0.5,
                    stroke_dasharray="2 2" if faint else None,
                ),
            )


def _points(trace: Scatter3d, view: _View) -> Iterator[tuple[float, str]]:
    look = trace.marker
    for place in np.transpose(_places(trace)):
        (px, py), near = view.at(place)
        yield near + 0.05, marker("circle", (float(px), float(py)), 1.5 * look.size, look.color)


def _box(scene: Scene, view: _View) -> Iterator[str]:
    """Floor and the two rear walls, each with its lines, and the three scales."""
    ticks = [round_steps(view.low[k], view.high[k], 5) for k in range(3)]
    share = [[(v - view.low[k]) / (view.high[k] - view.low[k]) for v in ticks[k]] for k in range(3)]
    for s in share[0]:
        yield _line(view, [(s, 0, 0), (s, 1, 0), (s, 1, 1)], _GRID)
    for s in share[1]:
        yield _line(view, [(0, s, 0), (1, s, 0), (1, s, 1)], _GRID)
    for s in share[2]:
        yield _line(view, [(0, 1, s), (1, 1, s), (1, 0, s)], _GRID)
    for edge in ([(0, 0, 0), (1, 0, 0)], [(0, 0, 0), (0, 1, 0)], [(0, 1, 0), (0, 1, 1)]):
        yield _line(view, edge, AXIS)
    for k, axis in enumerate((scene.xaxis, scene.yaxis, scene.zaxis)):
        for s, value in zip(share[k], ticks[k], strict=True):
            yield _beside(view, k, s, tick_label(value), 14)
        yield _beside(view, k, 0.5, axis.title.text, 34)


def _beside(view: _View, axis: int, share: float, words: str, away: float) -> str:
    """Text below an edge of the floor, or left of the vertical edge."""
    (x, y), _ = view.at(view.corner([(share, 0, 0), (0, share, 0), (0, 1, share)][axis]))
    if axis == 2:
        if away > 20:
            return text(words, float(x) - 44, float(y), turned=True)
        return text(words, float(x) - 6, float(y) + 4, "end", 11)
    side = 1 if axis == 0 else -1
    return text(words, float(x) + side * 0.5 * away, float(y) + 0.95 * away, "start" if axis == 0 else "end", 11)


def _line(view: _View, corners: Sequence[Sequence[float]], colour: str) -> str:
    places = [view.at(view.corner(corner))[0] for corner in corners]
    return path([[(float(x), float(y)) for x, y in places]], stroke=colour, stroke_width=0.8)
