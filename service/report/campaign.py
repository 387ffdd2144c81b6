"""The report of a campaign, a bundle or an estimate: verdict, origin, what was identified, what the data's check and a
diagnosis found."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from service.report.content import Content
from service.report.diagnosis import diagnosis_section, findings
from service.report.html import Page
from service.report.page import analysis_section, estimate_sections, parameters_section
from service.report.verdict import CONFIRMED, CONTRADICTED, OPEN, verdict
from service.results.check import DataCheck
from service.results.combination import Combination
from service.results.diagnosis import Diagnosis
from service.results.estimate import Estimate, Suspect

_LOOK = {CONFIRMED: "none", OPEN: "ambiguous", CONTRADICTED: "unknown"}  # of the card; the word stands in it


@dataclass(frozen=True, slots=True)
class Drive:
    """What a drive said of itself while `sweeps` sweeps were recorded (CiA 301 object 1018h)."""

    joint: str
    address: str
    vendor: int
    product: int
    revision: int
    serial: int
    dictionary_sha256: str
    sweeps: int


@dataclass(frozen=True, slots=True)
class CampaignReport:
    """What a campaign's report has beside the estimate. `origin`: what, and what is known of it, in order.

    `diagnosis`: number and content of the newest one. `test_mass`: kg.
    """

    title: str
    subtitle: str
    origin: tuple[tuple[str, str], ...]
    drives: tuple[Drive, ...]
    check: DataCheck | None
    diagnosis: tuple[int, Diagnosis] | None
    test_mass: float | None = None


def campaign_page(report: CampaignReport, joints: Sequence[str], estimate: Estimate, content: Content | None) -> Page:
    """`content`: None where the estimate has no inertia of an axis by itself, or its sweeps are not at hand."""
    page = Page(report.title, report.subtitle)
    found = verdict(estimate, report.check, report.diagnosis, report.test_mass)
    page.add(
        f'<div class="card {_LOOK[found.standing]}"><p class="verdict"><b>{found.standing}.</b> '
        f"{escape(found.sentence)}</p></div>"
    )
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


def _origin(page: Page, report: CampaignReport) -> None:
    page.origin(report.origin)
    page.add("<h3>Drives</h3>")
    if not report.drives:
        page.add("<p>Not recorded: the sweeps were imported, or measured without a fieldbus.</p>")
        return
    page.add("<p>As they told of themselves when the sweeps were recorded; a drive that was changed has two lines.</p>")
    page.table(
        ["joint", "address", "vendor", "product", "revision", "serial number", "dictionary (SHA-256)", "sweeps"],
        [
            [
                *(one.joint, one.address, f"{one.vendor:#x}", f"{one.product:#x}", f"{one.revision:#x}"),
                str(one.serial) if one.serial else "not told",
                one.dictionary_sha256[:12],
                str(one.sweeps),
            ]
            for one in report.drives
        ],
    )


def _tables(page: Page, estimate: Estimate) -> None:
    """What an estimate says of the axes where nothing can be drawn; nothing where it says nothing."""
    if not estimate.axes:
        return
    page.add("<h2>Inertia of the axes, sweep by sweep</h2>", "<p>kg m² (kg); reference: the CAD model.</p>")
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
        "<h2>Sweeps that do not fit the others</h2>", "<p>None is dropped; the worse one fits, the less it counts.</p>"
    )
    rows = [[one.sweep, one.axis, one.why, f"{one.weight:.2g}"] for one in suspects]
    page.table(["sweep", "axis", "why", "weight"], rows)


def _check(page: Page, check: DataCheck | None) -> None:
    page.add("<h2>Check of the data</h2>")
    if check is None:
        page.add(
            "<p>Not made yet: the service makes it when a campaign is over, <code>sweepid check</code> of a bundle.</p>"
        )
    elif not check.findings:
        page.add("<p>Nothing found.</p>")
    else:
        findings(page, check.findings)
