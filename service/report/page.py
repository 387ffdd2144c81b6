"""Content and order of the report."""

import math
from collections.abc import Collection, Sequence
from html import escape

from service.identification.estimates.initial_analysis import analyses_from
from service.model import Robot
from service.model.results.estimate import (
    CONFIDENCE,
    UNSURE,
    Analyses,
    Estimate,
    EstimatedAxis,
    axis_figures,
    not_for_use,
)
from service.model.results.part import two_digits, with_std
from service.report import figures, initial_analysis
from service.report.content import Content, ReportedAxis, axes_of
from service.report.drawing import slides
from service.report.html import ReportPage

_WHITE = "White: the robot would touch itself; the cell is not considered."


def main_values(page: ReportPage, estimate: Estimate, content: Content | None) -> None:
    """J of each axis with its interval, and where it differs from CAD: a picture, if the sweeps are known."""
    linear = frozenset[str]() if content is None else _linear(content.robot)
    page.facts(_main_value(joint, axis, "kg" if joint in linear else "kg m²") for joint, axis in estimate.axes.items())
    if estimate.axes:
        page.add(
            '<p class="note">J: medians over the measured poses, and their range; ± one standard deviation, with that '
            f"of the torque constant. Differences in percent of the identified. Confidence: {CONFIDENCE}.</p>"
        )
    axes = () if content is None else axes_of(content)
    first = next((axis for axis in axes if len(axis.varied) > 1), axes[0] if axes else None)
    if content is None or first is None:
        return
    page.add(f"<h3>{escape(first.joint)} against CAD</h3>")
    if len(first.varied) > 1:
        page.add(f"<p>Over the measured range: identified − CAD, in % of the identified. {_WHITE}</p>")
        page.figure(figures.deviation_map(content.robot, first))
    else:
        page.figure(figures.curve(content.robot, first))


def _main_value(joint: str, axis: EstimatedAxis, unit: str) -> tuple[str, str]:
    found = axis_figures(axis)
    value, std = with_std(found.identified, found.std)
    low, high, cad = (with_std(one, found.std)[0] for one in (found.lowest, found.highest, found.cad))
    differs = "" if math.isnan(found.percent) else f", {found.percent:+.1f} %"
    stated = axis.confidence_percent
    confidence = "no confidence stated" if stated is None else f"confidence {two_digits(stated)} %"
    return f"{value} ± {std} {unit}", f"J of {joint}, {low} to {high}; CAD {cad}{differs}; {confidence}"


def estimate_sections(page: ReportPage, content: Content) -> None:
    """The details of an estimate, from the initial analysis to the base parameters."""
    axes = axes_of(content)
    analysis_section(page, content.robot.joints, content.estimate.analysis, _linear(content.robot))
    _inertias(page, content, axes)
    _accuracy(page, content, axes)
    _convergence(page, content)
    _example(page, content)
    parameters_section(page, content.estimate)


def analysis_page(robot: Robot, analysis: Analyses) -> ReportPage:
    """A report of an initial analysis alone."""
    page = ReportPage(f"Initial analysis of the robot {robot.name}")
    analysis_section(page, robot.joints, analysis, _linear(robot))
    return page


def _linear(robot: Robot) -> frozenset[str]:
    return frozenset(joint for number, joint in enumerate(robot.joints) if slides(robot, number))


def analysis_section(
    page: ReportPage, joints: Sequence[str], analysis: Analyses, linear: Collection[str] = frozenset()
) -> None:
    """The initial analysis of an estimate, in the order of `joints`; nothing if it is empty.

    `linear`: the prismatic joints.
    """
    analyses = analyses_from(analysis)
    if not analyses:
        return
    page.add(
        "<h2>Initial analysis</h2>",
        "<p>Torque noise, or a stepped sine, on a slow turn in some poses from light to heavy. The "
        "inertia of an axis is identified best at the geometric mean of two frequencies: the corner "
        "below which friction dominates, and the first locked-rotor frequency, where the motor stands "
        "and the load oscillates.</p>",
    )
    for joint, axis in analyses.items():
        page.add(f"<h3>{escape(joint)}</h3>", "<p>Amplitude responses; dots measured, lines fitted.</p>")
        page.figure(initial_analysis.amplitude_responses(axis, linear=joint in linear))
        page.add(
            "<p>The same as an apparent inertia, pose by pose. Dashed: the asymptotes of inertia and friction. Dotted: "
            "the corner, the ideal frequency (blue, in the middle) and the locked-rotor frequency of the fit.</p>"
        )
        page.figure(initial_analysis.ideal_frequencies(axis, linear=joint in linear))
    page.add("<p>Both methods with one standard deviation: the fit, and in brackets the asymptotes.</p>")
    page.table(*initial_analysis.table(analyses, joints, linear))


def _inertias(page: ReportPage, content: Content, axes: Sequence[ReportedAxis]) -> None:
    poses = len({spec.pose for spec in content.specs})
    page.add(
        "<h2>Inertia of the axes over the poses</h2>",
        f"<p>{sum(len(axis.measured) for axis in axes)} sweeps of {len(axes)} axes in {poses} poses.</p>",
    )
    shown = next((axis.joint for axis in axes if len(axis.varied) > 1), "")
    for axis in axes:
        beyond = " and ".join(content.robot.joints[k] for k in axis.varied[:2])
        page.add(f"<h3>{escape(axis.joint)}{escape(f' over {beyond}') if beyond else ''}</h3>")
        if len(axis.varied) < 2:
            page.figure(figures.curve(content.robot, axis))
            continue
        page.add(
            "<p>The model identified from all sweeps, over the measured range. Points: measured inertias, in the same "
            f"colours. {_WHITE}</p>"
        )
        page.figure(figures.inertia_map(content.robot, axis))
        if axis.joint == shown:  # its difference from CAD is on the first page
            continue
        page.add(
            "<p>Where the robot differs from its CAD model: identified − reference, in % of the identified. "
            f"{_WHITE}</p>"
        )
        page.figure(figures.deviation_map(content.robot, axis))


def _accuracy(page: ReportPage, content: Content, axes: Sequence[ReportedAxis]) -> None:
    page.add("<h2>How well the models fit</h2>")
    labels = (
        "reference model − measurement",
        "identified model − measurement",
        "reference − identified model, whole workspace",
    )
    rows = [[label, *(f"{axis.rmse[k]:.2f}" for axis in axes)] for k, label in enumerate(labels)]
    page.add("<p>Root-mean-square error in percent of the second, as in Table 1 of the paper.</p>")
    page.table(["RMSE in %", *(axis.joint for axis in axes)], rows)
    if content.truth:
        page.add(
            "<p>This robot is virtual, so its true inertias are known; they were read after the last estimate. Sweeps: "
            "each measured inertia. Workspace: the models that follow, over all free poses of the cell's grid. "
            "Median of the absolute errors, in brackets the 95th percentile.</p>"
        )
        rows = [[row.label, *row.figures] for row in content.truth]
        page.table(["error against the truth in %", *content.truth_columns], rows)
    told = "Each measured inertia against the identified model, with two standard deviations."
    page.add("<h3>Residuals</h3>", f"<p>{told}</p>")
    page.figure(figures.residuals(axes))
    if any(math.isfinite(value) for axis in axes for value in axis.paper):
        page.add(
            "<p>The paper's formula (8) on the same sweeps. It assumes a stiff axis: where the load "
            "oscillates on the elasticity of the drive train, it overestimates the inertia.</p>"
        )
        page.figure(figures.paper_residuals(axes))


def _convergence(page: ReportPage, content: Content) -> None:
    if len(content.revisions) < 2:
        return
    names = [entry.name for entry in content.estimate.base_parameters]
    page.add(
        "<h2>Convergence</h2>",
        "<p>Every base parameter after each sweep, with a band of two standard deviations; each curve "
        "starts where the sweeps so far determine it. The full names are in the table at the end.</p>",
    )
    page.figure(figures.convergence(content.revisions, names))


def _example(page: ReportPage, content: Content) -> None:
    if content.example is None:
        return
    spec = content.example.spec
    robot = content.robot
    linear = slides(robot, robot.index(spec.axis))
    pose = ", ".join(_place(position, slides(robot, number)) for number, position in enumerate(spec.pose))
    page.add(
        "<h2>One sweep</h2>",
        f"<p>Sweep {escape(spec.id)} of {escape(spec.axis)} in pose ({escape(pose)}): a slow motion with sines on top. "
        "Whole periods of the shaded window are measured.</p>",
    )
    page.figure(figures.in_time(content.example, linear=linear))
    if spec.periodic:
        page.add("<p>Amplitudes over the measured window. Dots: the excited lines, which carry the inertia.</p>")
        page.figure(figures.in_frequency(content.example, linear=linear))


def _place(position: float, linear: bool) -> str:
    return f"{1e3 * position:.0f} mm" if linear else f"{math.degrees(position):.0f}°"


def parameters_section(page: ReportPage, estimate: Estimate) -> None:
    """The base parameters beside those of CAD, and which of them must not be used."""
    condition = estimate.condition_number
    page.add(
        "<h2>Base parameters</h2>",
        "<p>The combinations of inertial parameters that the inertias determine; each about its joint's frame."
        f"{'' if condition is None else f' Condition number of the sweeps: {condition:.3g}.'}</p>",
    )
    rows = [
        [
            entry.name if entry.symbolic is None else entry.symbolic,
            "–" if entry.reference is None else with_std(entry.reference, entry.std)[0],
            *with_std(entry.value, entry.std),
            figures.parameter_unit(entry.name),
            not_for_use(entry),
        ]
        for entry in estimate.base_parameters
    ]
    page.table(["parameter", "CAD", "identified", "± std", "unit", "not for use"], rows, "name")
    if any(row[-1] for row in rows):
        page.add(
            f"<p>Do not use: a value whose standard deviation is more than {100 * UNSURE:.0f} % of it, "
            "or that the data do not determine better than the CAD model, whose value is then "
            "shown.</p>"
        )
    for symbol, of in estimate.symbols.items():
        page.add(f'<p class="note">{escape(symbol)} = {of.value:.5g} {escape(of.unit)}, {escape(of.meaning)}</p>')
    page.add(
        '<p class="note">Standard deviations are conditional on the torque constants: a torque constant that is wrong '
        "by 1 % scales every inertia by 1 %, and no sweep shows it.</p>"
    )
