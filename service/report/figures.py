"""The report's figures as descriptions for plotly.js (plain data; nothing is drawn here)."""

from collections.abc import Sequence

import numpy as np

from service.model import Array, Robot, Sweep
from service.report.content import ReportedAxis, Revision
from service.report.drawing import (
    DECADES,
    IDENTIFIED,
    MEASURED,
    PAPER,
    REFERENCE,
    Drawn,
    DrawnFigure,
    Part,
    figure,
    line,
    looks,
    note,
    panels,
    points,
    position_title,
    positions,
    rounded,
    scale,
)


def inertia_map(robot: Robot, axis: ReportedAxis) -> DrawnFigure:
    """Inertia of the identified model over the two joints that vary most, and of each measured pose (Fig. 2)."""
    values = np.concatenate((axis.identified_workspace, axis.measured))
    ramp: Drawn = [[0, "#eff6ff"], [0.5, "#93c5fd"], [1, "#1e40af"]]
    ends = {"zmin": float(np.nanmin(values)), "zmax": float(np.nanmax(values))}
    return _map(
        robot,
        axis,
        axis.identified_workspace,
        {"colorscale": ramp, **ends, "colorbar": {"title": {"text": axis.unit}, "thickness": 12}},
        "measured, in the same colours",
        {
            **{"size": 9, "color": rounded(axis.measured), "colorscale": ramp},
            **{"cmin": ends["zmin"], "cmax": ends["zmax"], "line": {"color": "#0f172a", "width": 1}},
        },
    )


def deviation_map(robot: Robot, axis: ReportedAxis) -> DrawnFigure:
    """Difference between identified model and reference over the workspace, of the identified, and measured poses."""
    deviation = 100 * (1 - axis.reference_workspace / axis.identified_workspace)
    low, high = float(deviation.min()), float(deviation.max())
    if low * high < 0:
        high = max(high, -low)
        low = -high
        ramp = [[0, "#0f766e"], [0.5, "#f8fafc"], [1, "#c2410c"]]
    else:  # one sign only: the colours tell where it is more; less than half a percent is one colour
        middle, half = (low + high) / 2, max((high - low) / 2, 0.25)
        low, high = middle - half, middle + half
        ramp = [[0, "#fff7ed"], [1, "#c2410c"]] if middle > 0 else [[0, "#0f766e"], [1, "#f0fdfa"]]
    return _map(
        robot,
        axis,
        deviation,
        {"colorscale": ramp, "zmin": low, "zmax": high, "colorbar": {"title": {"text": "%"}, "thickness": 12}},
        "measured poses",
        {"size": 8, "color": "#0f172a", "line": {"color": "white", "width": 1.5}},
    )


def _map(robot: Robot, axis: ReportedAxis, values: Array, look: Part, name: str, marker: Part) -> DrawnFigure:
    """Values of the poses of the workspace as a field with contour lines, and the measured poses."""
    first, second = axis.varied[:2]
    places: Part = {kind: positions(robot, k, axis.poses[:, k]) for kind, k in (("x", first), ("y", second))}
    x, y, z = _mesh(axis.workspace, first, second, values)
    field: Part = {"x": positions(robot, first, x), "y": positions(robot, second, y), "z": rounded(z)}
    lines: Part = {"color": "#475569", "width": 0.8}
    return figure(
        [
            {"type": "heatmap", **field, **look},
            {"type": "contour", **field, "line": lines, "ncontours": 8, "showlegend": False},
            {"type": "scatter", "mode": "markers", "name": name, **places, "marker": marker},
        ],
        {"height": 430, "xaxis": scale(position_title(robot, first)), "yaxis": scale(position_title(robot, second))},
    )


def curve(robot: Robot, axis: ReportedAxis) -> DrawnFigure:
    """Inertia over the one joint after the axis that varies, or over the sweeps if none does."""
    if axis.varied:
        joint = axis.varied[0]
        order = np.argsort(axis.workspace[:, joint])
        line_x = positions(robot, joint, axis.workspace[order, joint])
        points_x, title = positions(robot, joint, axis.poses[:, joint]), position_title(robot, joint)
        identified, reference = axis.identified_workspace[order], axis.reference_workspace[order]
    else:
        line_x = points_x = list(axis.numbers)
        title, identified, reference = "sweep", axis.identified, axis.reference
    return figure(
        [
            line("reference model (CAD)", line_x, reference, REFERENCE, dash="dash"),
            line("identified model", line_x, identified, IDENTIFIED),
            points("paper's formula", points_x, axis.paper, PAPER, symbol="x-thin-open"),
            points("measured (± 2 std)", points_x, axis.measured, MEASURED, error=2 * axis.std),
        ],
        {"height": 380, "xaxis": scale(title), "yaxis": scale(f"J in {axis.unit}")},
    )


def residuals(axes: Sequence[ReportedAxis]) -> DrawnFigure:
    """Measured against identified model, percent, sweep by sweep with two standard deviations."""
    traces: list[Part] = []
    for axis, colour, symbol in looks(axes):
        percent = 100 / axis.identified
        off, error = (axis.measured - axis.identified) * percent, 2 * axis.std * percent
        traces.append(points(axis.joint, list(axis.numbers), off, colour, error, symbol))
    title = scale("(measured − identified) in %", zeroline=True)
    return figure(traces, {"height": 360, "xaxis": scale("sweep"), "yaxis": title})


def paper_residuals(axes: Sequence[ReportedAxis]) -> DrawnFigure:
    """The paper's formula against the identified model, percent, over the inertia."""
    traces: list[Part] = []
    for axis, colour, symbol in looks(axes):
        off = 100 * (axis.paper / axis.identified - 1)
        traces.append(points(axis.joint, rounded(axis.measured), off, colour, symbol=f"{symbol}-open"))
    units = " or ".join(dict.fromkeys(axis.unit for axis in axes))
    title = scale("(paper's formula − identified) in %", zeroline=True)
    return figure(traces, {"height": 360, "xaxis": scale(f"J measured in {units}"), "yaxis": title})


def convergence(revisions: Sequence[Revision], names: Sequence[str]) -> DrawnFigure:
    """Each base parameter over the number of sweeps, with a band of two standard deviations: small multiples."""
    columns = 3
    traces: list[Part] = []
    annotations: list[Drawn] = []
    height = 50 + 175 * -(-len(names) // columns)
    layout: dict[str, Drawn] = {"height": height, "showlegend": False, "annotations": annotations}
    for k, (name, (here, left, top, width, high)) in enumerate(zip(names, panels(len(names), columns), strict=True)):
        # undetermined parameters would set the scale: start when the std has the order of its final value
        final = revisions[-1]
        shown = [r for r in revisions if r.std[k] < max(30 * final.std[k], 1e-12)]
        x = [r.sweeps for r in shown]
        value, std = np.array([r.values[k] for r in shown]), np.array([r.std[k] for r in shown])
        band: Part = {**here, "mode": "lines", "line": {"width": 0}}
        traces += [
            {**band, "x": x, "y": rounded(value - 2 * std)},
            {**band, "x": x, "y": rounded(value + 2 * std), "fill": "tonexty", "fillcolor": "#1d4ed82e"},
            {**line(name, x, value, IDENTIFIED), **here},
        ]
        number = str(here["xaxis"])[1:]
        layout[f"xaxis{number}"] = {
            **scale("sweeps" if k + columns >= len(names) else ""),
            "domain": [left + 0.13 * width, left + 0.98 * width],
            "anchor": here["yaxis"],
            "range": [0, revisions[-1].sweeps + 1],
        }
        layout[f"yaxis{number}"] = {
            **scale(""),
            "domain": [top - 0.76 * high, top - 0.16 * high],
            "anchor": here["xaxis"],
            "nticks": 4,
        }
        told = f"{_short(name)} in {parameter_unit(name)}" if x else f"{_short(name)}: not identified"
        annotations.append(note(told, left + 0.13 * width, top - 0.13 * high))
    return figure(traces, layout)


def in_time(sweep: Sweep, *, linear: bool = False) -> DrawnFigure:
    """One sweep: velocity and effort over time, the measured window shaded. `linear`: of a prismatic axis."""
    recording, spec = sweep.recording, sweep.spec
    step = max(1, len(recording.time) // 4000)
    time = rounded(recording.time[::step], 4)
    setpoint = recording.velocity_setpoint
    wanted = [] if setpoint is None else [line("set-point", time, 1e3 * setpoint[::step], REFERENCE)]
    window: Part = {
        **{"type": "rect", "xref": "x", "yref": "paper", "x0": spec.measure_from, "x1": _end(sweep), "y0": 0, "y1": 1},
        **{"fillcolor": "#f1f5f9", "line": {"width": 0}, "layer": "below"},
    }
    return figure(
        [
            *wanted,
            line("velocity", time, 1e3 * recording.velocity[::step], IDENTIFIED),
            {**line("effort", time, recording.effort[::step], MEASURED), "yaxis": "y2"},
        ],
        {**_above("time in s", linear), "shapes": [window] if spec.periodic else []},
    )


def _end(sweep: Sweep) -> float:
    """Of the measured window, s."""
    return sweep.spec.measure_from + (sweep.spec.period or 0.0) * (sweep.spec.periods or 0)


def _above(title: str, linear: bool, kind: Part | None = None) -> Part:
    """Velocity above effort."""
    return {
        "height": 430,
        "xaxis": {**scale(title), "anchor": "y2"},
        "yaxis": {**scale(f"velocity in {'mm' if linear else 'mrad'}/s"), "domain": [0.55, 1.0], **(kind or {})},
        "yaxis2": {**scale(f"effort in {'N' if linear else 'N m'}"), "domain": [0.0, 0.45], **(kind or {})},
    }


def in_frequency(sweep: Sweep, *, linear: bool = False) -> DrawnFigure:
    """Amplitudes of velocity and effort over the measured complete periods; the excited lines are highlighted."""
    spec, recording = sweep.spec, sweep.recording
    half = 0.5 / spec.sample_rate
    inside = (recording.time >= spec.measure_from - half) & (recording.time < _end(sweep) - half)
    count = int(inside.sum())
    frequency = np.asarray(np.fft.rfftfreq(count, 1 / spec.sample_rate), dtype=float)
    shown = (frequency > 0) & (frequency <= 20.0)
    lines = [sine.frequency for sine in spec.sines]
    excited = shown & (np.abs(frequency[:, None] - np.array([lines])).min(axis=1) < 1e-6)
    traces: list[Part] = []
    for name, samples, factor, colour, y in (
        ("velocity", recording.velocity, 1e3, IDENTIFIED, "y"),
        ("effort", recording.effort, 1.0, MEASURED, "y2"),
    ):
        amplitude = np.asarray(2 * factor * np.abs(np.fft.rfft(samples[inside])) / count, dtype=float)
        traces += [
            {**line(name, rounded(frequency[shown], 4), amplitude[shown], colour, width=1.2), "yaxis": y},
            {**points(f"{name}, excited", rounded(frequency[excited], 4), amplitude[excited], colour), "yaxis": y},
        ]
    return figure(traces, _above("frequency in Hz", linear, DECADES))


def _mesh(poses: Array, first: int, second: int, values: Array) -> tuple[Array, Array, Array]:
    """Values of scattered grid poses as a matrix (y, x), NaN where the grid has no pose; first of equal poses."""
    x, column = np.unique(np.round(poses[:, first], 9), return_inverse=True)
    y, row = np.unique(np.round(poses[:, second], 9), return_inverse=True)
    matrix = np.full((len(y), len(x)), np.nan)
    matrix[row[::-1], column[::-1]] = values[::-1]
    return x, y, matrix


def parameter_unit(name: str) -> str:
    """The unit of a base parameter, which is that of its first term: m(link), mx(link), Ixx(link) or Jm(joint)."""
    kind = name.partition("(")[0]
    return "kg" if kind == "m" else "kg m" if kind in ("mx", "my", "mz") else "kg m²"


def _short(name: str) -> str:
    """The first parameter of a combination; the full name is in the table."""
    head, _, rest = name.partition(" ")
    return f"{head} + …" if rest else head
