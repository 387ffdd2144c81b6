"""The figures of a diagnosis, from the diagnosis of one axis."""

import math
from collections.abc import Sequence

import numpy as np

from service.model.results.diagnosis import AxisDiagnosis, Bin, Cell, Rival
from service.report.drawing import IDENTIFIED, Drawn, DrawnFigure, Part, figure, line, note, rounded, scale, upright

BEFORE, AFTER, FLOOR, QUIET = "#c2410c", IDENTIFIED, "#15803d", "#e0b8a2"
LEFT: Part = {"symbol": "diamond", "size": 9, "color": AFTER}  # a bar of nothing would not be seen


def gap_map(axis: AxisDiagnosis) -> DrawnFigure | None:
    """The gap for each property of sweeps and samples, before and after.

    What repeats has no noise in it, so the noise floor, which is that of a single sweep, has no place beside it.
    """
    dimensions: dict[str, list[Cell]] = {}
    for cell in axis.where:
        dimensions.setdefault(cell.dimension, []).append(cell)
    if not dimensions:
        return None
    panels = [_panel(name, cells, axis.explained) for name, cells in dimensions.items()]
    panels.sort(key=lambda panel: -len(panel.labels))  # panels of one height in one row
    columns = 3
    heights = [20 * len(panels[k].labels) + 62 for k in range(0, len(panels), columns)]  # the first is the highest
    largest = max(cell.rms for cell in axis.where)
    annotations: list[Drawn] = []
    layout: dict[str, Drawn] = {
        "height": sum(heights) + 70,
        "margin": {"l": 10, "r": 10, "t": 40, "b": 30},
        "barmode": "overlay",
        "meta": {"width": 960},  # px; needed for names of bins next to three panels
        "annotations": annotations,
    }
    traces = _keys(axis)
    top = 1.0
    for k, panel in enumerate(panels):
        tail = "" if k == 0 else str(k + 1)
        left, height = k % columns / columns, heights[k // columns]
        share = height / sum(heights)
        top -= heights[k // columns - 1] / sum(heights) if k and k % columns == 0 else 0.0
        here = {"xaxis": f"x{tail}", "yaxis": f"y{tail}", "showlegend": False}
        traces += [{**here, **trace} for trace in panel.traces]
        layout[f"xaxis{tail}"] = {
            **scale(""),
            "domain": [left + 0.12, left + 0.985 / columns],
            **{"anchor": f"y{tail}", "range": [0, 1.06 * largest], "nticks": 5, "tickfont": {"size": 11}},
        }
        layout[f"yaxis{tail}"] = {
            **scale(""),
            "domain": [top - share * (height - 25) / height, top - share * 25 / height],
            **{"anchor": f"x{tail}", "type": "category", "autorange": "reversed", "automargin": False},
            **{"tickfont": {"size": 11}, "showgrid": False},
        }
        annotations.append(note(panel.title, left, top - share * 23 / height))
    annotations.append(
        note(f"RMS of the repeatable gap in {axis.unit}", 1.0, 0.0, xanchor="right", yanchor="top", yshift=-14)
    )
    return figure(traces, layout)


class _Panel:
    """One property: its bins in order, a bar of each before, and a mark after."""

    def __init__(self, title: str, cells: Sequence[Cell], labels: list[str], after: bool) -> None:
        self.title, self.labels = title, labels
        significance = [cell.significance for cell in cells]
        shown = {"y": labels, "customdata": [round(value, 1) for value in significance]}
        # standard deviations from zero gap
        before = {
            "type": "bar",
            "orientation": "h",
            "x": rounded(np.array([cell.rms for cell in cells])),
            "marker": {"color": [BEFORE if value > 5.0 else QUIET for value in significance]},
            "hovertemplate": "%{y}: %{x:.3g} before, significance %{customdata}<extra></extra>",
            "width": 0.72,
        }
        self.traces: list[Part] = [{**shown, **before}]
        if after:
            left = {
                "type": "scatter",
                "mode": "markers",
                "x": rounded(np.array([cell.rms_after for cell in cells])),
                "marker": LEFT,
                "cliponaxis": False,
                "hovertemplate": "%{y}: %{x:.3g} after<extra></extra>",
            }
            self.traces.append({**shown, **left})


def _panel(name: str, cells: Sequence[Cell], after: bool) -> _Panel:
    bins = [(cell.bin, cell) for cell in cells]
    pairs = sorted(((one, cell) for one, cell in bins if one is not None), key=lambda pair: pair[0].low)
    if len(pairs) < len(cells):
        ordered = sorted(cells, key=lambda cell: cell.value)
        return _Panel(name, ordered, [_words(cell.value) for cell in ordered], after)
    size = max(abs(end) for one, _ in pairs for end in (one.low, one.high) if end is not None)
    labels = [_label(one, size) for one, _ in pairs]
    measure = pairs[0][0].unit.replace("s2", "s²")
    return _Panel(f"{name} ({measure})", [cell for _, cell in pairs], labels, after)


def _label(one: Bin, size: float) -> str:
    ends = " … ".join(_short(end, size) for end in (one.low, one.high) if end is not None)
    return ends if one.parts is None else f"{ends}/{one.parts}"


def _keys(axis: AxisDiagnosis) -> list[Part]:
    """The entries of the legend; the bars themselves are in many panels."""
    bar: Part = {"type": "bar", "x": [None], "y": [None]}
    keys: list[Part] = [
        {**bar, "name": "before", "marker": {"color": BEFORE}},
        {**bar, "name": "before, not significant", "marker": {"color": QUIET}},
    ]
    if axis.explained:
        keys.append({"type": "scatter", "mode": "markers", "x": [None], "y": [None], "name": "after", "marker": LEFT})
    return keys


def gap_by_pose(axis: AxisDiagnosis) -> DrawnFigure:
    """Cross-validated gap before and after in each pose, with the noise floor."""
    poses = axis.gap.by_pose
    labels = pose_labels([pose.pose for pose in poses])
    bars = [
        {
            "type": "bar",
            "name": name,
            "x": labels,
            "y": rounded(np.array(values)),
            "marker": {"color": colour, "pattern": {"shape": pattern}},
            "customdata": [pose.sweeps for pose in poses],
            "hovertemplate": f"%{{y:.3g}} {axis.unit} {name}, %{{customdata}} sweeps<extra></extra>",
        }
        for name, values, colour, pattern in (
            ("before", [pose.before_rms for pose in poses], BEFORE, ""),
            ("after", [pose.after_rms for pose in poses], AFTER, "/"),
        )
        if name == "before" or axis.explained
    ]
    floor = {
        "type": "scatter",
        "mode": "markers",
        "name": "noise floor",
        "x": labels,
        "y": rounded(np.array([number(pose.noise_floor_rms) for pose in poses])),
        "marker": {"symbol": "line-ew-open", "size": 56, "color": FLOOR, "line": {"width": 2.5, "color": FLOOR}},
        "hovertemplate": "noise floor %{y:.3g}<extra></extra>",
    }
    return figure(
        [*bars, floor],
        {
            "height": 360,
            "bargap": max(0.35, 1 - 0.16 * len(poses)),
            "xaxis": {**scale("pose: positions of the joints that vary, rad (m)"), "type": "category"},
            "yaxis": {**scale(f"RMS of the gap in {axis.unit}"), "rangemode": "tozero"},
        },
    )


def example(axis: AxisDiagnosis) -> DrawnFigure:
    """The sweep with the largest gap: measured effort, effort of both models, and the residual."""
    sweep = axis.example
    time = rounded(np.array(sweep.time), 4)
    measured, before, after = (np.array(effort, dtype=float) for effort in (sweep.measured, sweep.before, sweep.after))
    traces = [
        line("measured", time, measured, "#64748b", width=3),
        line("model before", time, before, BEFORE, width=1.4),
        {**line("left before", time, measured - before, BEFORE, width=1.2), "yaxis": "y2", "showlegend": False},
    ]
    if axis.explained:
        traces += [
            line("model after", time, after, AFTER, dash="dot", width=1.8),
            {**line("left after", time, measured - after, AFTER, width=1.2), "yaxis": "y2", "showlegend": False},
        ]
    return figure(
        traces,
        {
            "height": 480,
            "xaxis": {**scale("time in s"), "anchor": "y2"},
            "yaxis": {**scale(f"effort in {axis.unit}"), "domain": [0.45, 1.0]},
            "yaxis2": {**scale(f"left in {axis.unit}", zeroline=True), "domain": [0.0, 0.37]},
        },
    )


def evidence(axis: AxisDiagnosis) -> DrawnFigure | None:
    """Difference of each other candidate from the chosen explanation, on a logarithmic scale."""
    rivals = axis.rivals
    if not rivals or not axis.effects:
        return None
    # a long name of several effects would leave no room for the others
    count = len(axis.effects)
    chosen = effect_words(axis.effects[0].effect) if count == 1 else f"The {count} effects above"
    rows = [(chosen, 0.0, AFTER), *((effect_words(r.effect), r.behind, _colour(axis, r)) for r in rivals)]
    names, behind, colours = zip(*rows, strict=True)
    places = [_signed_power(value) for value in behind]
    ticks = [-1e4, -1e3, -100.0, -10.0, 0.0, 10.0, 100.0, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8]
    ticks = [tick for tick in ticks if min(places) - 1 <= _signed_power(tick) <= max(places) + 1]
    # of Schwarz's criterion: a rival with a larger difference is excluded
    return figure(
        [
            {
                "type": "bar",
                "orientation": "h",
                "x": [round(place, 4) for place in places],
                "y": list(names),
                "marker": {"color": list(colours)},
                "text": ["chosen", *(_behind(axis, rival) for rival in rivals)],
                "textposition": "outside",
                "cliponaxis": False,
                "hoverinfo": "skip",
            }
        ],
        {
            "height": 110 + 24 * len(rows),
            "margin": {"l": 10, "r": 130, "t": 20, "b": 55},  # text next to the longest bar
            "xaxis": {
                **scale("behind the chosen explanation by (Schwarz's criterion)", zeroline=True),
                "tickvals": [_signed_power(tick) for tick in ticks],
                "ticktext": [f"{tick:,.0f}" for tick in ticks],
            },
            "yaxis": {**scale(""), "autorange": "reversed", "type": "category", "showgrid": False},
            "shapes": [upright("", _signed_power(10.0), "#64748b")],
        },
    )


def parameters(axis: AxisDiagnosis) -> DrawnFigure | None:
    """Each parameter of the named effects with two standard deviations, in percent of its value."""
    rows = [
        (f"{effect_words(effect.effect)}: {plain(name)}", value)
        for effect in axis.effects
        for name, value in effect.parameters.items()
        if value.value and value.significant
    ]
    if not rows:
        return None
    interval = [200 * abs(number(value.std) / value.value) for _, value in rows]
    reach = min(1.15 * max((one for one in interval if math.isfinite(one)), default=10.0) + 1, 250)
    nothing = [upright("", -100.0, "#64748b")] if reach > 100 else []
    return figure(
        [
            {
                "type": "scatter",
                "mode": "markers",
                "x": [0.0] * len(rows),
                "y": [name for name, _ in rows],
                "marker": {"size": 9, "color": AFTER},
                "error_x": {"array": rounded(np.array(interval)), "color": AFTER, "thickness": 2, "width": 6},
                "text": [value.words for _, value in rows],
                "hovertemplate": "%{y} = %{text}<extra></extra>",
            }
        ],
        {
            "height": 90 + 30 * len(rows),
            "margin": {"l": 10, "r": 20, "t": 10, "b": 55},
            "xaxis": {
                **scale(f"± 2 std in % of the value{' (dashed: no effect)' if nothing else ''}", zeroline=True),
                "range": [-reach, reach],
            },
            "yaxis": {**scale(""), "autorange": "reversed", "type": "category", "range": [-0.5, len(rows) - 0.5]},
            "shapes": nothing,
        },
    )


def plain(name: str) -> str:
    """The name of an effect, a block or a parameter in words."""
    return name.replace("_", " ").replace("coulomb", "Coulomb").replace("stribeck", "Stribeck")


def effect_words(effect: str) -> str:
    """An effect's name in words, as a sentence begins."""
    words = plain(effect)
    return words[:1].upper() + words[1:]


def unit_words(unit: str) -> str:
    """A unit in readable form."""
    return unit.replace("^2", "²")


def pose_labels(poses: Sequence[Sequence[float]]) -> list[str]:
    """Positions of the joints that differ between poses; numbered if these are not unique."""
    values = np.array(poses, dtype=float)
    varying = np.flatnonzero(np.ptp(values, axis=0) > 5e-3)
    labels = [", ".join(f"{value:+.2f}" for value in pose[varying]) or "the pose" for pose in values]
    if len(set(labels)) == len(labels):
        return labels
    return [f"{k}: {label}" for k, label in enumerate(labels, start=1)]


def _colour(axis: AxisDiagnosis, rival: Rival) -> str:
    return "#b45309" if rival.effect in axis.candidates else "#94a3b8"


def _behind(axis: AxisDiagnosis, rival: Rival) -> str:
    """In words too, because colours cannot be distinguished in grey print."""
    return f"{round(rival.behind):,}{', not ruled out' if rival.effect in axis.candidates else ''}"


def _signed_power(value: float) -> float:
    return math.copysign(math.log10(1 + abs(value)), value)


def _words(value: str) -> str:
    """Name of a block; a block measured again in a later campaign ends with the number of that campaign."""
    return value.replace("_", " ").replace(" of campaign ", " #")


def _short(value: float, size: float) -> str:
    """Three digits; from 1000 on without an exponent, which would overlap the next panel."""
    shown = 0.0 if abs(value) < 1e-3 * size else value
    return f"{shown:.0f}" if 1e3 <= abs(shown) < 1e6 else f"{shown:.3g}"


def number(value: float | None) -> float:
    """NaN for unknown values."""
    return float("nan") if value is None else float(value)
