"""The result of a diagnosis, as a page or as a section of the report; only from its document."""

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from service.model.results.diagnosis import AxisDiagnosis, Diagnosis, Finding, Gap, RigidParameter, standing_of
from service.model.results.effect import AxisFit, Effect, Value
from service.model.results.part import with_std
from service.report import gap_figures as drawn
from service.report.drawing import DrawnFigure
from service.report.gap_figures import plain
from service.report.html import ReportPage


def diagnosis_figures(document: Diagnosis) -> dict[str, dict[str, DrawnFigure]]:
    """All figures by joint and name (`map`, `gap_by_pose`, `example`, `evidence`, `parameters`)."""
    return {joint: figures_of(axis) for joint, axis in document.axes.items()}


def figures_of(axis: AxisDiagnosis) -> dict[str, DrawnFigure]:
    """The figures of one axis."""
    # Figures by name, in the order of a page; a builder returns None if there is nothing to draw.
    builders = {
        "map": drawn.gap_map,
        "gap_by_pose": drawn.gap_by_pose,
        "example": drawn.example,
        "evidence": drawn.evidence,
        "parameters": drawn.parameters,
    }
    made = {name: build(axis) for name, build in builders.items()}
    return {name: figure for name, figure in made.items() if figure is not None}


def diagnosis_page(
    document: Diagnosis, title: str, subtitle: str = "", origin: Sequence[tuple[str, str]] = ()
) -> ReportPage:
    """A report of a diagnosis alone. `origin`: names and values, in order."""
    page = ReportPage(title, subtitle)
    if origin:
        page.add(*(f"<p><b>{escape(axis.summary)}</b></p>" for axis in document.axes.values()))
        page.add(*not_looked_at(document.axes))
        page.origin(origin)
    for joint, axis in document.axes.items():
        page.add(f"<h2>{escape(joint)}</h2>")
        _axis(page, joint, axis)
    return page


def not_looked_at(axes: Mapping[str, AxisDiagnosis]) -> list[str]:
    """What the sweeps of the diagnosed axes cannot show, for the first page of a report."""
    lines: list[str] = []
    for joint, axis in axes.items():
        parts = [] if axis.has_noise_floor else ["no sweep was repeated, so there is no noise floor"]
        parts += [f"not visible: {', '.join(map(plain, axis.untestable))}"] if axis.untestable else []
        parts += [f"of these, would change the estimate: {', '.join(map(plain, axis.biasing))}"] if axis.biasing else []
        lines += [f"<li>{escape(joint)}: {escape('; '.join(parts))}</li>"] if parts else []
    return ["<h3>What was not looked at</h3>", "<ul>", *lines, "</ul>"] if lines else []


def diagnosis_section(page: ReportPage, document: Diagnosis, of: str = "") -> None:
    """The diagnosis as a section at the end of another report. `of`: a sentence, if that is of another machine."""
    page.add(
        f"<h2>Where model and measurement disagree{': another machine' if of else ''}</h2>",
        *([f"<p><b>{escape(of)}</b></p>"] if of else []),
        "<p>The effort of the rigid model is computed along every recorded motion. The repeatable "
        "difference to the measured effort is the gap. The effects of a catalogue are fitted to it "
        "and verified on sweeps that were not used for the fit.</p>",
    )
    for joint, axis in document.axes.items():
        page.add(f"<h3>{escape(joint)}</h3>")
        _axis(page, joint, axis)


def _axis(page: ReportPage, joint: str, axis: AxisDiagnosis) -> None:
    figures = figures_of(axis)
    page.add(f'<div class="card {standing_of(axis)}"><p class="verdict">{escape(axis.summary)}</p></div>')
    reported = {finding.sentence for finding in axis.data}
    if reported:
        page.add("<h3>Check of the data</h3>")
        findings(page, axis.data)
    page.add(*(f"<p><b>warning:</b> {escape(one.sentence)} {escape(one.action)}</p>" for one in axis.unfinished))
    _gap(page, axis)
    if "map" in figures:
        page.add(
            "<h3>Where the gap is</h3>",
            *(f"<p>{escape(sentence)}</p>" for sentence in axis.sentences if sentence not in reported),
        )
        page.figure(figures["map"])
    if axis.known:
        _known(page, axis)
    if axis.explained:
        _effects(page, axis, figures)
    if axis.part:
        page.add(
            "<h3>Known in part</h3>",
            "<p>In addition, a part of the gap is not explained by any effect of the catalogue.</p>",
        )
        page.table(["effect", "parameter", "value", "± std", "unit"], _parameter_rows(axis.part))
    if axis.law is not None:
        page.add(
            "<h3>Proposed law</h3>",
            f"<p>{escape(axis.law.sentence)} <code>{escape(axis.law.formula)}</code></p>",
        )
        page.table(["parameter", "value", "± std", "unit"], _value_rows(axis.law.parameters))
    if axis.rigid_model:
        _rigid_model(page, axis.rigid_model, axis.started_from)
    sweep, block = axis.example.sweep, axis.example.block
    page.add(
        "<h3>Example</h3>",
        f"<p>Sweep {escape(sweep)}{escape(f' ({plain(block)})') if block else ''}, the sweep with the "
        f"largest gap before. Above: the effort; below: the residual of the model, {_residuals(axis)}. "
        "The gap is that of all sweeps, without the samples around standstill: there friction may have any value, and "
        "this residual may have spikes.</p>",
    )
    page.figure(figures["example"])
    _open_questions(page, joint, axis)


def _residuals(axis: AxisDiagnosis) -> str:
    """Of the example, as it is drawn."""
    models = {"before": axis.example.before} | ({"after": axis.example.after} if axis.explained else {})
    left = {name: np.array(axis.example.measured) - np.array(model) for name, model in models.items()}
    return " and ".join(
        f"{name} {np.sqrt(np.mean(rest**2)):.3g} {axis.unit} RMS (at most {np.abs(rest).max():.3g} {axis.unit})"
        for name, rest in left.items()
    )


def _gap(page: ReportPage, axis: AxisDiagnosis) -> None:
    gap, unit = axis.gap, axis.unit
    facts = [(f"{gap.before_rms:.3g} {unit}", f"gap before, {gap.before_percent:.3g} % of the effort")]
    if axis.explained:
        facts.append((f"{gap.after_rms:.3g} {unit}", f"gap after, {gap.after_percent:.3g} %"))
    floor = gap.noise_floor_rms
    facts += [
        ("–", "noise floor: nothing was measured twice")
        if floor is None
        else (f"{floor:.3g} {unit}", "noise floor, from repeats"),
        (str(gap.held_out_sweeps), "sweeps that took no part in naming or fit")
        if gap.held_out_sweeps
        else ("–", "no pose could be kept out of the naming"),
    ]
    if gap.twin_rms is not None:
        facts.append((f"{gap.twin_rms:.3g} {unit}", "left by the simulator with this model"))
    page.facts(facts)
    page.add(f"<p>{_how_judged(gap)}</p>")
    page.figure(drawn.gap_by_pose(axis))


def _how_judged(gap: Gap) -> str:
    if gap.held_out_sweeps:
        return (
            "Before and after are those of one pose that was not used for naming or fit. In the figure pose "
            "by pose below, each pose is evaluated with parameters from the other poses."
        )
    if not gap.cross_validated:
        return "One pose without repeats: nothing could be held out, so the fit is evaluated on its own sweeps."
    return (
        "Cross-validated: each pose is evaluated with parameters from the other poses; where only one pose shows an "
        "effect, or there is only one pose, each sweep is evaluated with parameters from its repeats."
    )


def _known(page: ReportPage, axis: AxisDiagnosis) -> None:
    """Known effects: parameters from these sweeps, next to those in the model."""
    changed = {(change.effect, change.parameter): change.model for change in axis.changes}
    named = [(effect.effect, name, value) for effect in axis.known for name, value in effect.parameters.items()]
    rows = [
        [drawn.effect_words(effect), plain(name), *_value(value), _model(changed.get((effect, name)))]
        for effect, name, value in named
    ]
    page.add("<h3>What the model has already</h3>", "<p>Fitted again to these sweeps.</p>")
    page.table(["effect", "parameter", "value", "± std", "unit", "the model says"], rows)


def _model(value: Value | None) -> str:
    return "the same" if value is None else " ± ".join(with_std(value.value, value.std))


def _effects(page: ReportPage, axis: AxisDiagnosis, figures: Mapping[str, DrawnFigure]) -> None:
    decided = axis.verdict == "named"
    page.add(f"<h3>{'What explains it' if decided else 'The simplest explanation so far, not decided'}</h3>")
    for effect in axis.effects:
        page.add(
            f"<p><b>{escape(drawn.effect_words(effect.effect))}.</b> {escape(effect.sentence)} "
            f"<code>{escape(effect.physics)}</code> "
            f'<span class="note">({escape(effect.source)})</span></p>'
        )
    page.table(["effect", "parameter", "value", "± std", "unit"], _parameter_rows(axis.effects))
    if "parameters" in figures:
        page.figure(figures["parameters"])
    if "evidence" in figures:
        page.add(
            "<p>Every other candidate in place of the chosen one, and how far behind it is. Amber: "
            "not ruled out. Grey: ruled out, because it is far behind (beyond the dashed line), has "
            "more parameters without explaining more, or is not physical.</p>"
        )
        page.figure(figures["evidence"])
    _fit(page, axis.fit)


def _parameter_rows(effects: Sequence[Effect]) -> list[list[str]]:
    return [[drawn.effect_words(one.effect), *row] for one in effects for row in _value_rows(one.parameters)]


def _value_rows(parameters: Mapping[str, Value]) -> list[list[str]]:
    """A coefficient of which the sweeps tell nothing has no value."""
    nothing = ["not significant", "–", ""]
    return [[plain(name), *(_value(value) if value.significant else nothing)] for name, value in parameters.items()]


def findings(page: ReportPage, found: Sequence[Finding]) -> None:
    """Findings of the data check. If one is wrong, no physics was named."""
    ordered = sorted(found, key=lambda one: one.severity != "wrong")
    page.add(*(f"<p><b>{escape(one.severity)}:</b> {escape(one.sentence)} {escape(one.action)}</p>" for one in ordered))


def _rigid_model(page: ReportPage, parameters: Sequence[RigidParameter], started_from: str) -> None:
    """The rigid model of CAD and data sheet, or of an estimate, next to that of these sweeps."""
    by_cad = started_from == "cad"
    page.add(
        "<h3>The rigid model</h3>",
        "<p>Base parameters of inertia and gravity about the axis, kg, kg m and kg m², and viscous "
        "friction, N m s/rad (N s/m). The values found are corrections within the prior, not effects. "
        "Parameters that the measured poses do not determine keep the value of "
        f"{'CAD' if by_cad else 'the estimate'} and the uncertainty of its prior.</p>",
        "" if by_cad else f"<p>Started from an estimate: {escape(started_from)}.</p>",
    )
    rows = [
        [
            plain(one.name) if one.name.isidentifier() else one.name,  # else it is a formula
            "–" if one.nominal is None else with_std(one.nominal, one.std)[0],
            *with_std(one.value, one.std),
        ]
        for one in parameters
    ]
    page.table(["parameter", "CAD" if by_cad else "estimate", "found", "± std"], rows)


def _fit(page: ReportPage, fit: AxisFit) -> None:
    labels = drawn.pose_labels([entry.pose for entry in fit.inertia])
    page.add(
        "<p>The axis again, with the effects in its model; kg m² and N m s/rad, of a linear axis kg and N s/m.</p>"
    )
    named = [*zip((f"inertia at {label}" for label in labels), fit.inertia, strict=True)]
    rows = [[name, *with_std(one.value, one.std)] for name, one in (*named, ("viscous friction", fit.viscous_friction))]
    page.table(["", "value", "± std"], rows)


def _open_questions(page: ReportPage, joint: str, axis: AxisDiagnosis) -> None:
    experiment = axis.next_experiment
    if experiment is not None:
        sweeps = experiment.sweeps
        poses = len({sweep.spec.pose for sweep in sweeps})
        size = f"{len(sweeps)} sweeps of {escape(joint)} in {poses} poses, " if sweeps else ""
        page.add(
            "<h3>What to measure next</h3>",
            f"<p><b>{escape(drawn.effect_words(experiment.kind))}.</b> {escape(experiment.reason)} "
            f"{size}{_duration(experiment.seconds)} of machine time.</p>",
        )
    if axis.untestable:
        page.add(
            "<h3>What these sweeps cannot show</h3>", "<p>These effects can neither be confirmed nor excluded:</p>"
        )
        rows = [
            [drawn.effect_words(effect), ", ".join(plain(block) for block in axis.visible_in.get(effect, ()))]
            for effect in axis.untestable
        ]
        page.table(["effect", "it shows in"], rows)


def _value(value: Value) -> list[str]:
    return [*with_std(value.value, value.std), drawn.unit_words(value.unit)]


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
