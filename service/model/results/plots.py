# pyright: reportUnknownMemberType=false
# matplotlib's types leave keyword arguments open
"""What results draw of themselves, by matplotlib; a notebook shows it, a script by ``matplotlib.pyplot.show()``."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes

from service.model.recording import Sweep
from service.model.results.part import Table


def inertias(found: Mapping[str, Table]) -> Sequence[Axes]:
    """Of each axis, by joint: the inertia in the pose of each sweep with two standard deviations, and both models."""
    _, panels = pyplot.subplots(len(found), squeeze=False, figsize=(7, 3 * len(found)), layout="constrained")
    drawn: list[Axes] = list(panels[:, 0])
    for (joint, table), panel in zip(found.items(), drawn, strict=True):
        sweeps = np.arange(len(table["measured"]))
        panel.errorbar(sweeps, table["measured"], 2 * table["std"], fmt="o", capsize=3, label="measured (± 2 std)")
        panel.plot(sweeps, table["identified"], "_", markersize=14, label="identified model")
        panel.plot(sweeps, table["reference"], "x", label="reference model (CAD)")
        panel.set(title=joint, xlabel="sweep", ylabel="J in kg m² (kg)")
        panel.locator_params("x", integer=True)
    drawn[0].legend()
    return drawn


def sources(table: Table) -> Axes:
    """The standard deviation of each base parameter by each source, and by all together."""
    names = [name if len(name) < 30 else f"{name[:28]}…" for name in table["parameter"]]
    rows = np.arange(len(names))
    _, axes = pyplot.subplots(figsize=(8, 2 + 0.22 * len(names)), layout="constrained")
    for column, marker in {"of the model": "x", "std by sweeps": "s", "by trajectories": "^", "std": "o"}.items():
        axes.plot(table[column], rows, marker, fillstyle="none", label="together" if column == "std" else column)
    axes.set(xscale="log", xlabel="standard deviation, SI")
    axes.set_yticks(rows, names)
    axes.invert_yaxis()
    axes.legend()
    return axes


def gaps(table: Table) -> Axes:
    """The gap of each axis before and after the named effects, and its noise floor."""
    places = np.arange(len(table["axis"]))
    _, axes = pyplot.subplots(figsize=(7, 4), layout="constrained")
    for name, marker in {"before": "x", "after": "o", "noise floor": "_"}.items():
        axes.plot(places, table[name], marker, fillstyle="none", markersize=10, label=name)
    axes.set_xticks(
        places, [f"{joint}\n{verdict}" for joint, verdict in zip(table["axis"], table["verdict"], strict=True)]
    )
    axes.set(yscale="log", xlim=(-0.5, len(places) - 0.5), ylabel="gap in N m (N), RMS")
    axes.legend()
    return axes


def body(table: Table) -> Sequence[Axes]:
    """Mass, centre of mass and inertia of a payload, each with two standard deviations."""
    _, panels = pyplot.subplots(1, 3, figsize=(9, 3), width_ratios=(1, 3, 6), layout="constrained")
    parts = {"mass, kg": slice(0, 1), "centre of mass, m": slice(1, 4), "inertia about it, kg m²": slice(4, None)}
    for panel, (title, part) in zip(panels, parts.items(), strict=True):
        names = [name.removeprefix("center ").removesuffix(" about the center") for name in table[""][part]]
        places = np.arange(len(names))
        panel.errorbar(places, table["value"][part], 2 * table["std"][part], fmt="o", capsize=3)
        panel.set_xticks(places, names)
        panel.set(title=title, xlim=(-0.5, len(names) - 0.5))
    return tuple(panels)


def promise(confidence: Sequence[float | None]) -> Axes:
    """The predicted confidence of the inertia after each pose of a plan, as soon as it is determined."""
    _, axes = pyplot.subplots(figsize=(7, 4), layout="constrained")
    axes.plot(range(1, len(confidence) + 1), np.array(confidence, dtype=float), "o-", fillstyle="none")
    axes.set(xlabel="poses", ylabel="largest standard deviation of J in percent")
    axes.set_xlim(0.5, len(confidence) + 0.5)
    axes.set_ylim(0.0, 1.1 * max(filter(None, confidence), default=1.0))
    axes.locator_params("x", integer=True)
    return axes


def efforts(sweeps: Sequence[Sweep]) -> Sequence[Axes]:
    """The effort of each sweep, by the axis that moves."""
    joints = tuple(dict.fromkeys(sweep.spec.axis for sweep in sweeps))
    _, panels = pyplot.subplots(len(joints), squeeze=False, figsize=(7, 3 * len(joints)), layout="constrained")
    for joint, panel in zip(joints, panels[:, 0], strict=True):
        panel.set(title=joint, xlabel="time in s", ylabel="effort in N m (N)")
        for recording in (sweep.recording for sweep in sweeps if sweep.spec.axis == joint):
            panel.plot(recording.time, recording.effort, linewidth=0.5)
    return tuple(panels[:, 0])
