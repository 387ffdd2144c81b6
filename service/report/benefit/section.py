"""The section of a report about the benefit of an estimate: a sentence in plain words, a figure, the values."""

from collections.abc import Callable, Sequence
from html import escape

from service.model.results.part import with_std
from service.report.benefit.benefit import AxisBenefit, Benefit, ModelBenefit, Tracking
from service.report.drawing import IDENTIFIED, REFERENCE, Drawn, DrawnFigure, Part, figure, scale
from service.report.html import ReportPage


def benefit_section(page: ReportPage, found: Benefit) -> None:
    """The section; only the reasons if no axis can be compared."""
    page.add("<h2>What you gain</h2>")
    if found.axes:
        page.add(f'<div class="card"><p class="verdict">{escape(sentence(found))}</p></div>')
        page.add(
            "<p>Judged in poses that took no part in the estimate. Left: what a torque feed-forward with either model "
            "leaves to the position controller, of the torque that the sines of a sweep take. Right: the smallest "
            "force at the end of the robot that a monitor of the drive torque tells, across the lever arm. Less is "
            "better.</p>"
        )
        page.figure(worth(found))
        page.table(*_table(found))
        page.add(
            f'<p class="note">Every {found.every}th pose of an axis is held out. The drive train is the same for both '
            "models and dry friction is fitted to each, so that the difference is that of the rigid bodies alone. ± is "
            "one standard deviation. The monitor compares measured and predicted torque at every sample, with one "
            f"false alarm in {found.quiet_hours:g} hours.</p>"
        )
    if found.tracking is not None:
        _tracking(page, found.tracking)
    for joint, why in found.not_judged.items():
        page.add(f"<p>Not judged: {escape(joint)} {escape(why)}.</p>")


def sentence(found: Benefit) -> str:
    """What changes for the user of the robot; requires at least one axis."""
    axes = list(found.axes.values())
    left = (_span([model.left_percent for model in models]) for models in _both(axes))
    summary = (
        "With the identified model a torque feed-forward leaves {} % of the test motion's torque to the position "
        "controller, with CAD {} %."
    ).format(*left)
    forces = [one for one in axes if one.cad.smallest_force is not None]
    if forces:
        seen = (_span([model.smallest_force or 0.0 for model in models]) for models in _both(forces))
        summary += " A torque monitor sees a push of {} N at the end of the robot; with CAD it takes {} N.".format(
            *seen
        )
    worse = [joint for joint, one in found.axes.items() if one.lines_ratio <= 1]
    return f"{summary} On {', '.join(worse)} the estimate is no better than CAD." if worse else summary


def _tracking(page: ReportPage, found: Tracking) -> None:
    ratios = [found.cad[joint].rms / one.rms for joint, one in found.identified.items()]
    page.add(
        "<h3>The same path with either model</h3>",
        f"<p>A move of {found.duration:.1f} s, all measured axes at once, at up to {found.top_speed:.2g} rad/s and "
        f"{found.top_acceleration:.2g} rad/s². With torque feed-forward of the identified model the axes keep to it "
        f"{_span(ratios)} times as closely as with that of CAD.</p>",
    )
    rows = [
        [joint, *(f"{1000 * size:.3g}" for size in (cad.rms, own.rms, cad.peak, own.peak))]
        for joint, cad, own in ((joint, found.cad[joint], own) for joint, own in found.identified.items())
    ]
    page.table(
        ["error on the path in mrad (mm)", "RMS, CAD", "RMS, estimate", "largest, CAD", "largest, estimate"], rows
    )
    page.add(
        '<p class="note">A simulation: mechanics and speed controllers of the virtual machine under position '
        f"controllers (gain {found.gain:g} 1/s), not its drives, which take no torque feed-forward. Friction is fed "
        "forward as the sweeps showed it, the same with both models.</p>"
    )


def worth(found: Benefit) -> DrawnFigure:
    """Both models for each axis: remaining torque in percent, and smallest force in N."""
    joints, axes = list(found.axes), list(found.axes.values())
    panels: tuple[tuple[str, str, Callable[[ModelBenefit], float | None]], ...] = (
        ("", "left by a feed-forward in %", lambda model: model.left_percent),
        ("2", "smallest force seen in N", lambda model: model.smallest_force),
    )
    traces: list[Part] = []
    layout: dict[str, Drawn] = {"height": 360, "bargap": 0.35, "meta": {"width": 960}}
    for number, (tail, title, size) in enumerate(panels):
        identified, cad = _both(axes)
        for name, models, colour, pattern in (("CAD", cad, REFERENCE, "/"), ("estimate", identified, IDENTIFIED, "")):
            sizes = [size(model) for model in models]
            traces.append(
                {
                    "type": "bar",
                    "name": name,
                    "x": joints,
                    "y": sizes,
                    "text": [_number(value) for value in sizes],
                    "marker": {"color": colour, "pattern": {"shape": pattern}},
                    "xaxis": f"x{tail}",
                    "yaxis": f"y{tail}",
                    "showlegend": not tail,
                }
            )
        highest = max((size(model) or 0.0 for model in (*cad, *identified)), default=0.0)
        layout[f"xaxis{tail}"] = {
            **scale(""),
            "type": "category",
            "domain": [0.54 * number, 0.46 + 0.54 * number],
            "anchor": f"y{tail}",
        }
        # 1.15: room for the number above the highest bar
        layout[f"yaxis{tail}"] = {**scale(title), "anchor": f"x{tail}", "range": [0, 1.15 * (highest or 1.0)]}
    return figure(traces, layout)


def _table(found: Benefit) -> tuple[list[str], list[list[str]]]:
    head = ["", "inertia off in %", "left at the sines", "left in all", "smallest torque seen", "smallest force in N"]
    rows: list[list[str]] = []
    for joint, axis in found.axes.items():
        rows += [
            _row(f"{joint}, {name}", axis.unit, model)
            for name, model in (("CAD", axis.cad), ("estimate", axis.identified))
        ]
    return head, rows


def _row(label: str, unit: str, model: ModelBenefit) -> list[str]:
    off = model.inertia_percent
    return [
        label,
        f"{off.value:.2f}" if off.std is None else " ± ".join(with_std(off.value, off.std)),
        *(f"{size:.3g} {unit}" for size in (model.lines_rms, model.effort_rms, model.smallest_effort)),
        _number(model.smallest_force),
    ]


def _both(axes: Sequence[AxisBenefit]) -> tuple[list[ModelBenefit], list[ModelBenefit]]:
    """The identified models, and those of CAD."""
    return [axis.identified for axis in axes], [axis.cad for axis in axes]


def _span(sizes: Sequence[float]) -> str:
    low, high = (f"{size:.2g}" if size < 100 else f"{size:.0f}" for size in (min(sizes), max(sizes)))
    return low if low == high else f"{low} to {high}"


def _number(size: float | None) -> str:
    return "–" if size is None else f"{size:.2g}" if size < 100 else f"{size:.0f}"
