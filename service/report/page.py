"""The report as one HTML file: tables as HTML, figures drawn by the plotly.js of the installed wheel, inlined."""

import json
import math
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from typing import Any

from service.identification.analysis_document import analyses_from
from service.report import figures, initial_analysis
from service.report.content import Axis, Content, Document, axes_of
from service.robot import Robot

_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.55 system-ui, sans-serif; color: #0f172a; background: #f8fafc; margin: 0; }
main { max-width: 1060px; margin: 0 auto; padding: 40px 28px 80px; }
h1 { font-size: 30px; line-height: 1.2; margin: 0 0 6px; letter-spacing: -0.01em; }
h2 { font-size: 21px; margin: 48px 0 6px; letter-spacing: -0.005em; }
h3 { font-size: 16px; margin: 22px 0 4px; }
p { margin: 6px 0 12px; color: #334155; max-width: 78ch; }
p.lead { color: #475569; margin-bottom: 24px; }
.card { background: white; border: 1px solid #e2e8f0; border-radius: 10px; padding: 14px 18px; margin: 14px 0; }
.facts { display: grid; grid-template-columns: repeat(auto-fit, minmax(170px, 1fr)); gap: 12px; margin: 20px 0; }
.facts div { background: white; border: 1px solid #e2e8f0; border-radius: 10px; padding: 12px 16px; }
.facts b { display: block; font-size: 24px; font-weight: 600; line-height: 1.3; }
.facts span { color: #64748b; font-size: 13.5px; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { padding: 7px 12px; text-align: right; border-bottom: 1px solid #e2e8f0; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; white-space: normal; }
thead th { color: #475569; font-weight: 600; border-bottom: 2px solid #cbd5e1; }
tbody tr:last-child td { border-bottom: 0; }
td.name { font-size: 14px; max-width: 560px; overflow-wrap: anywhere; }
.note { color: #64748b; font-size: 14px; }
@media print { body { background: white; } .card, .facts div { break-inside: avoid; } }
"""

_SCRIPT = """
const figures = JSON.parse(document.getElementById("figures").textContent);
for (const [id, figure] of Object.entries(figures)) {
  Plotly.newPlot(id, figure.data, figure.layout, { displaylogo: false, responsive: true });
}
"""


def render(content: Content) -> str:
    """The whole report; deterministic for equal content. About 5 MB, nearly all of it plotly.js."""
    page = _Page()
    axes = axes_of(content)
    page.add(f"<h1>{escape(content.title)}</h1>", f'<p class="lead">{escape(content.subtitle)}</p>')
    _facts(page, content, axes)
    _initial_analysis(page, content.robot, content.estimate.get("analysis", {}))
    _inertias(page, content, axes)
    _accuracy(page, content, axes)
    _convergence(page, content)
    _example(page, content)
    _parameters(page, content)
    return page.html(content.title)


def render_analysis(robot: Robot, analysis: Document) -> str:
    """A report of an initial analysis alone ("analysis" of an estimate's document)."""
    title = f"Initial analysis of the robot {robot.name}"
    page = _Page()
    page.add(f"<h1>{escape(title)}</h1>")
    _initial_analysis(page, robot, analysis)
    return page.html(title)


def _initial_analysis(page: "_Page", robot: Robot, analysis: Document) -> None:
    analyses = analyses_from(analysis)
    if not analyses:
        return
    page.add(
        "<h2>Initial analysis</h2>",
        "<p>Torque noise, or a stepped sine, on a slow turn in some poses from light to heavy. In between the corner "
        "below which friction rules and the first locked-rotor frequency, where the motor stands and the load swings, "
        "an axis shows its inertia best: at their geometric mean.</p>",
    )
    for joint, axis in analyses.items():
        page.add(f"<h3>{escape(joint)}</h3>", "<p>Amplitude responses; dots measured, lines fitted.</p>")
        page.figure(initial_analysis.amplitude_responses(axis))
        page.add(
            "<p>The same as an apparent inertia, pose by pose. Dashed: the asymptotes of inertia and friction. Dotted: "
            "the corner, the ideal frequency (blue) and the locked-rotor frequency of the fit.</p>"
        )
        page.figure(initial_analysis.ideal_frequencies(axis))
    page.add("<p>Both ways side by side, with one standard deviation: by the fit, in brackets by the asymptotes.</p>")
    page.table(*initial_analysis.table(analyses, robot.joints))


def _facts(page: "_Page", content: Content, axes: Sequence[Axis]) -> None:
    condition = content.estimate["condition_number"]
    poses = len({spec.pose for spec in content.specs})
    facts = [
        (str(sum(len(axis.measured) for axis in axes)), "sweeps"),
        (str(poses), "poses"),
        (str(len(axes)), "axes"),
        (str(len(content.estimate["base_parameters"])), "base parameters"),
        ("–" if condition is None else f"{condition:.1f}", "condition number"),
    ]
    cells = "".join(f"<div><b>{escape(value)}</b><span>{escape(name)}</span></div>" for value, name in facts)
    page.add(f'<div class="facts">{cells}</div>')


def _inertias(page: "_Page", content: Content, axes: Sequence[Axis]) -> None:
    page.add("<h2>Inertia of the axes over the poses</h2>")
    for axis in axes:
        beyond = " and ".join(content.robot.joints[k] for k in axis.varied[:2])
        page.add(f"<h3>{escape(axis.joint)}{escape(f' over {beyond}') if beyond else ''}</h3>")
        if len(axis.varied) < 2:
            page.figure(figures.curve(content.robot, axis))
            continue
        page.add("<p>Surfaces: the model identified from all sweeps and the CAD model. Points: measured inertias.</p>")
        page.figure(figures.surface(content.robot, axis))
        page.add("<p>Where the robot differs from its CAD model: identified against reference. White: not free.</p>")
        page.figure(figures.deviation_map(content.robot, axis))


def _accuracy(page: "_Page", content: Content, axes: Sequence[Axis]) -> None:
    page.add("<h2>How well the models fit</h2>")
    labels = (
        "reference model − measurement",
        "identified model − measurement",
        "reference − identified model, whole workspace",
    )
    rows = [[label, *(f"{axis.rmse[k]:.2f}" for axis in axes)] for k, label in enumerate(labels)]
    page.add("<p>Root-mean-square error in percent, as in Table 1 of the paper.</p>")
    page.table(["RMSE in %", *(axis.joint for axis in axes)], rows)
    if content.truth:
        page.add(
            "<p>This robot is virtual, so its true inertias are known; they were read after the last estimate. Sweeps: "
            "each measured inertia. Workspace: the models that follow, over all free poses of the cell's grid. "
            "Median of the absolute errors, in brackets the 95th percentile.</p>"
        )
        page.table(
            ["error against the truth in %", *content.truth_columns], [[r.label, *r.figures] for r in content.truth]
        )
    page.add(
        "<h3>Residuals</h3>", "<p>Each measured inertia against the identified model, with two standard deviations.</p>"
    )
    page.figure(figures.residuals(axes))
    if any(math.isfinite(value) for axis in axes for value in axis.paper):
        page.add(
            "<p>The paper's formula (8) on the same sweeps. It takes the axis as stiff: where the load swings on the "
            "drive train's elasticity, it reads too much.</p>"
        )
        page.figure(figures.paper_residuals(axes))


def _convergence(page: "_Page", content: Content) -> None:
    if len(content.revisions) < 2:
        return
    names = [entry["name"] for entry in content.estimate["base_parameters"]]
    page.add(
        "<h2>Convergence</h2>",
        "<p>Every base parameter after each sweep, with a band of two standard deviations; each curve starts where the "
        "sweeps so far determine it. Whole names stand in the table at the end.</p>",
    )
    page.figure(figures.convergence(content.revisions, names))


def _example(page: "_Page", content: Content) -> None:
    if content.example is None:
        return
    spec = content.example.spec
    pose = ", ".join(f"{math.degrees(position):.0f}°" for position in spec.pose)
    page.add(
        "<h2>One sweep</h2>",
        f"<p>Sweep {escape(spec.id)} of {escape(spec.axis)} in pose ({escape(pose)}): a slow turn with sines on top. "
        "Whole periods of the shaded window are measured.</p>",
    )
    page.figure(figures.in_time(content.example))
    if spec.periodic:
        page.add("<p>Amplitudes over the measured window. Dots: the excited lines, which carry the inertia.</p>")
        page.figure(figures.in_frequency(content.example))


def _parameters(page: "_Page", content: Content) -> None:
    page.add(
        "<h2>Base parameters</h2>",
        "<p>The combinations of inertial parameters that the inertias determine; kg, kg m and kg m², each about its "
        "joint's frame.</p>",
    )
    rows = [
        [
            entry.get("symbolic", entry["name"]),
            f"{entry['value']:.5g}",
            "–" if entry["std"] is None else f"{entry['std']:.2g}",
        ]
        for entry in content.estimate["base_parameters"]
    ]
    page.table(["parameter", "value", "± std"], rows, "name")
    symbols: dict[str, Any] = content.estimate.get("symbols", {})  # stored before there were words: none
    for symbol, of in symbols.items():
        page.add(
            f'<p class="note">{escape(symbol)} = {of["value"]:.5g} {escape(of["unit"])}, {escape(of["meaning"])}</p>'
        )
    page.add(
        '<p class="note">Standard deviations are conditional on the torque constants: a torque constant that is wrong '
        "by 1 % scales every inertia by 1 %, and no sweep shows it.</p>"
    )


class _Page:
    """Collects the body and the figures."""

    def __init__(self) -> None:
        self._body: list[str] = []
        self._figures: dict[str, Any] = {}

    def add(self, *parts: str) -> None:
        self._body += parts

    def figure(self, figure: figures.Figure) -> None:
        name = f"figure-{len(self._figures) + 1}"
        self._figures[name] = figure
        self._body.append(
            f'<div class="card"><div id="{name}" style="height:{figure["layout"]["height"]}px"></div></div>'
        )

    def table(self, head: Iterable[str], rows: Iterable[Sequence[str]], first: str = "") -> None:
        top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
        body = "".join(
            f'<tr><td class="{first}">{escape(row[0])}</td>'
            + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:])
            + "</tr>"
            for row in rows
        )
        table = f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"
        self._body.append(f'<div class="card scroll">{table}</div>')

    def html(self, title: str) -> str:
        # "</" would end the script element early; JSON may escape the slash
        data = json.dumps(self._figures, allow_nan=False, separators=(",", ":")).replace("</", "<\\/")
        return "\n".join(
            (
                "<!doctype html>",
                '<html lang="en"><head><meta charset="utf-8">',
                '<meta name="viewport" content="width=device-width, initial-scale=1">',
                f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body><main>",
                *self._body,
                "</main>",
                f"<script>{plotly_js()}</script>",
                f'<script type="application/json" id="figures">{data}</script>',
                f"<script>{_SCRIPT}</script></body></html>",
            )
        )


def plotly_js() -> str:
    """plotly.js of the installed wheel."""
    return files("plotly").joinpath("package_data", "plotly.min.js").read_text(encoding="utf-8")
