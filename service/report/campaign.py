"""The report of a campaign, a bundle or an estimate: verdict, origin, identified values, findings of the data check and
of a diagnosis."""

from collections.abc import Sequence
from html import escape

from service.model.results.combination import Combination
from service.model.results.diagnosis import DataCheck
from service.model.results.estimate import Estimate, Suspect
from service.report.content import CampaignReport, Content
from service.report.diagnosis import diagnosis_section, findings, not_looked_at
from service.report.html import Page
from service.report.page import analysis_section, estimate_sections, parameters_section
from service.report.verdict import CONFIRMED, CONTRADICTED, OPEN, verdict

_LOOK = {CONFIRMED: "settled", OPEN: "open", CONTRADICTED: "unexplained"}  # CSS class of the card; the word is on it


def campaign_page(report: CampaignReport, joints: Sequence[str], estimate: Estimate, content: Content | None) -> Page:
    """`content`: None if the estimate has no inertia of a single axis, or its sweeps are not available."""
    page = Page(report.title, report.subtitle)
    found = verdict(estimate, report.check, report.diagnosis, report.test_mass)
    page.add(
        f'<div class="card {_LOOK[found.standing]}"><p class="verdict"><b>{found.standing}.</b> '
        f"{escape(found.sentence)}</p></div>"
    )
    page.add(*_not_looked_at(report, estimate))
    _origin(page, report)
    page.first_page_ends()
    if content is not None:
        estimate_sections(page, content)
    else:
        analysis_section(page, joints, estimate.analysis)
        _tables(page, estimate)
    if estimate.combination is not None:
        _combination(page, estimate.combination)
    _suspects(page, estimate.suspect)
    _check(page, report.check)
    if report.diagnosis is not None:
        diagnosis_section(page, report.diagnosis[1])
    return page


def _not_looked_at(report: CampaignReport, estimate: Estimate) -> list[str]:
    axes = {} if report.diagnosis is None else report.diagnosis[1].axes
    undiagnosed = [joint for joint in estimate.axes if joint not in axes]
    if not undiagnosed:
        return not_looked_at(axes)
    lines = not_looked_at(axes) or ["<h3>What was not looked at</h3>", "<ul>", "</ul>"]
    joints = escape(", ".join(undiagnosed))
    return [*lines[:-1], f"<li>{joints}: no diagnosis, so no effect was looked for</li>", lines[-1]]


def _origin(page: Page, report: CampaignReport) -> None:
    page.origin(report.origin)
    page.add("<h3>Drives</h3>")
    if not report.drives:
        page.add("<p>Not recorded: the sweeps were imported, or measured without a fieldbus.</p>")
        return
    page.add("<p>As reported by the drives when the sweeps were recorded; a drive that was changed has two lines.</p>")
    page.table(
        ["joint", "address", "vendor", "product", "revision", "serial number", "dictionary (SHA-256)", "sweeps"],
        [
            [
                *(one.joint, one.address, f"{one.vendor:#x}", f"{one.product:#x}", f"{one.revision:#x}"),
                str(one.serial) if one.serial else "not reported",
                one.dictionary_sha256[:12],
                str(one.sweeps),
            ]
            for one in report.drives
        ],
    )


def _tables(page: Page, estimate: Estimate) -> None:
    """The values of an estimate for axes without a figure; nothing if there are none."""
    if not estimate.axes:
        return
    page.add(
        "<h2>Inertia of the axes, sweep by sweep</h2>", "<p>kg m², of a linear axis kg; reference: the CAD model.</p>"
    )
    rows = [
        [joint, one.sweep, f"{one.value:.5g}", f"{one.std:.2g}", f"{one.identified:.5g}", f"{one.reference:.5g}"]
        for joint, axis in estimate.axes.items()
        for one in axis.inertia
    ]
    page.table(["axis", "sweep", "measured", "± std", "identified", "reference"], rows)
    page.add(
        "<h2>How well the models fit</h2>", "<p>Root-mean-square error in percent, as in Table 1 of the paper.</p>"
    )
    fits = [
        [
            joint,
            *(f"{size:.2f}" for size in (fit.reference_measured, fit.identified_measured, fit.reference_identified)),
        ]
        for joint, fit in ((joint, axis.rmse_percent) for joint, axis in estimate.axes.items())
    ]
    head = ["axis", "reference − measurement", "identified − measurement", "reference − identified, workspace"]
    page.table(head, fits)
    parameters_section(page, estimate)


def _combination(page: Page, combination: Combination) -> None:
    page.add(
        "<h2>Sweeps and trajectories together</h2>",
        "<p>The base parameters of the whole dynamics, SI, and what determines them.</p>",
    )
    page.table(
        ["parameter", "value", "± std", "determined by", "not for use"],
        [
            [
                one.name,
                f"{one.value:.5g}",
                "–" if one.std is None else f"{one.std:.2g}",
                one.reason or one.source,
                "" if one.identified else "not identified",
            ]
            for one in combination.base_parameters
        ],
        "name",
    )


def _suspects(page: Page, suspects: Sequence[Suspect]) -> None:
    if not suspects:
        return
    page.add(
        "<h2>Sweeps that do not fit the others</h2>",
        "<p>No sweep is dropped; a sweep that fits worse has less weight.</p>",
    )
    rows = [[one.sweep, one.axis, one.why, f"{one.weight:.2g}"] for one in suspects]
    page.table(["sweep", "axis", "why", "weight"], rows)


def _check(page: Page, check: DataCheck | None) -> None:
    page.add("<h2>Check of the data</h2>")
    if check is None:
        page.add(
            "<p>Not done yet: the service checks the data at the end of a campaign, <code>sweepid "
            "check</code> checks a bundle.</p>"
        )
    elif not check.findings:
        page.add("<p>Nothing found.</p>")
    else:
        findings(page, check.findings)
