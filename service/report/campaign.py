"""The report of a campaign, a bundle or an estimate: verdict, origin, identified values, findings of the data check and
of a diagnosis."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from service.model.results.combination import Combination
from service.model.results.diagnosis import DataCheck, Diagnosis, standing_of
from service.model.results.estimate import CONFIDENCE, UNSURE, Estimate, Suspect, share_of_sweeps, share_of_value
from service.model.results.part import two_digits, with_std
from service.report.content import CampaignReport, Content
from service.report.diagnosis import diagnosis_section, findings, not_looked_at
from service.report.gap_figures import plain
from service.report.html import ReportPage
from service.report.page import analysis_section, estimate_sections, main_values, parameters_section

CONFIRMED, OPEN, CONTRADICTED = "Confirmed", "Not confirmed", "Contradicted"

_CARD = {CONFIRMED: "settled", OPEN: "open", CONTRADICTED: "unexplained"}  # CSS class of the card; the word is on it


@dataclass(frozen=True, slots=True)
class EstimateVerdict:
    """The verdict on the estimate (one of the three words above) and the reasons; one sentence each."""

    standing: str
    sentence: str


def verdict(
    estimate: Estimate, check: DataCheck | None, diagnosis: tuple[int, Diagnosis] | None, test_mass: float | None = None
) -> EstimateVerdict:
    """The verdict from an estimate, the findings of the data check, and number and document of the newest diagnosis."""
    parts = (_of_estimate(estimate), _of_mass(test_mass), _of_check(check), _of_diagnosis(estimate, diagnosis))
    standings = {standing for standing, _ in parts}
    standing = next(one for one in (CONTRADICTED, OPEN, CONFIRMED) if one in standings)
    return EstimateVerdict(standing, f"{'; '.join(sentences for _, sentences in parts if sentences)}.")


def _of_estimate(estimate: Estimate) -> tuple[str, str]:
    shares = {joint: share_of_value(axis) for joint, axis in estimate.axes.items()}
    if not shares:
        return OPEN, "No inertia of a single axis was identified, only the results below"
    unsure = [joint for joint, share in shares.items() if not share <= UNSURE]
    sure = [joint for joint in shares if joint not in unsure]
    sentences: list[str] = []
    if sure:
        swept = {joint: share_of_sweeps(estimate.axes[joint]) for joint in sure}
        worst = max(sure, key=lambda joint: swept[joint])
        stated = estimate.axes[worst].confidence_percent is not None
        total = two_digits(100 * max(shares[joint] for joint in sure))
        sentences.append(
            f"{_inertias(sure)} known to {two_digits(100 * swept[worst])} % or better"
            f" ({f'confidence: {CONFIDENCE}' if stated else 'median standard deviation of the sweeps'}"
            f"{f'; {worst} is the least accurate' if len(sure) > 1 else ''}), to {total} % with the uncertainty of the "
            "torque constants"
        )
    if unsure:
        sentences.append(f"{_inertias(unsure)} too uncertain to use")
    suspects = estimate.suspect
    if suspects:
        sentences.append(f"{_count(len(suspects), 'sweep does', 'sweeps do')} not fit the others")
    text = ", but ".join(sentences)
    open_ = sum(entry.std is None for entry in estimate.base_parameters)
    if open_:
        text += f"; the sweeps do not identify {open_} of {len(estimate.base_parameters)} base parameters"
    return (OPEN if unsure or suspects else CONFIRMED), text[:1].upper() + text[1:]


def _of_mass(test_mass: float | None) -> tuple[str, str]:
    if test_mass is None:
        return CONFIRMED, ""
    return OPEN, f"a test mass of {test_mass:g} kg was mounted, so this is not the bare robot"


def _of_check(check: DataCheck | None) -> tuple[str, str]:
    if check is None:
        return OPEN, "the data were not checked yet"
    wrong = [one for one in check.findings if one.severity == "wrong"]
    if wrong:
        codes = sorted({f"{one.code.replace('_', ' ')} of {one.axis or 'the robot'}" for one in wrong})
        return CONTRADICTED, f"but the data check says that the data cannot be trusted ({', '.join(codes)})"
    warnings = len(check.findings)
    return CONFIRMED, f"the data check found {_count(warnings, 'warning', 'warnings') if warnings else 'nothing'}"


def _of_diagnosis(estimate: Estimate, diagnosis: tuple[int, Diagnosis] | None) -> tuple[str, str]:
    """An effect that is included in the estimate is not missing from it."""
    if diagnosis is None:
        return OPEN, "no diagnosis was made"
    number, document = diagnosis
    taken = {(one.axis, one.effect) for one in estimate.effects if one.used}
    against: list[str] = []
    untold: list[str] = []
    for joint, axis in document.axes.items():
        if joint not in estimate.axes:
            continue
        effects = [one.effect for one in axis.effects if (joint, one.effect) not in taken]
        if axis.verdict == "named" and effects:
            against.append(f"the model of {joint} lacks {_list([plain(effect) for effect in effects])}")
        elif axis.verdict == "ambiguous":
            against.append(f"the model of {joint} lacks an effect that is not named yet")
        elif axis.verdict == "unknown":
            against.append(f"{joint} has a gap that no known effect explains")
        elif standing_of(axis) == "open":
            untold.append(joint)
    if against:
        return CONTRADICTED, f"but diagnosis {number} contradicts it: {', '.join(against)}"
    asked = [joint for joint in estimate.axes if joint in document.axes and joint not in untold]
    if len(asked) < len(estimate.axes):
        left = [joint for joint in estimate.axes if joint not in asked]
        return OPEN, f"diagnosis {number} does not decide whether an effect is missing in {_list(left)}"
    return CONFIRMED, f"diagnosis {number} finds no effect missing"


def _inertias(joints: Sequence[str]) -> str:
    return f"the inertia of {_list(joints)} is" if len(joints) == 1 else f"the inertias of {_list(joints)} are"


def _list(names: Sequence[str]) -> str:
    return " and ".join(part for part in (", ".join(names[:-1]), names[-1]) if part)


def _count(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"


def campaign_page(
    report: CampaignReport, joints: Sequence[str], estimate: Estimate, content: Content | None
) -> ReportPage:
    """`content`: None if the estimate has no inertia of a single axis, or its sweeps are not available."""
    page = ReportPage(report.title, report.subtitle)
    found = verdict(estimate, report.check, report.diagnosis, report.test_mass)
    page.add(
        f'<div class="card {_CARD[found.standing]}"><p class="verdict"><b>{found.standing}.</b> '
        f"{escape(found.sentence)}</p></div>"
    )
    main_values(page, estimate, content)
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


def _origin(page: ReportPage, report: CampaignReport) -> None:
    page.origin(report.origin)
    page.add("<h3>Drives</h3>")
    if not report.drives:
        page.add("<p>Not recorded: the sweeps were imported, or measured without a fieldbus.</p>")
        return
    page.add("<p>As reported by the drives when the sweeps were recorded; a drive that was changed has two lines.</p>")
    head = ["joint", "address", "vendor", "product", "revision", "serial number", "dictionary (SHA-256)", "sweeps"]
    rows = [
        [
            *(one.joint, one.address, f"{one.vendor:#x}", f"{one.product:#x}", f"{one.revision:#x}"),
            *(str(one.serial or "not reported"), one.dictionary_sha256[:12], str(one.sweeps)),
        ]
        for one in report.drives
    ]
    page.table(head, rows)


def _tables(page: ReportPage, estimate: Estimate) -> None:
    """The values of an estimate for axes without a figure; nothing if there are none."""
    if not estimate.axes:
        return
    page.add(
        "<h2>Inertia of the axes, sweep by sweep</h2>", "<p>kg m², of a linear axis kg; reference: the CAD model.</p>"
    )
    rows = [
        [joint, one.sweep, *with_std(one.value, one.std), *(with_std(model, one.std)[0] for model in models)]
        for joint, axis in estimate.axes.items()
        for one in axis.inertia
        for models in [(one.identified, one.reference)]
    ]
    page.table(["axis", "sweep", "measured", "± std", "identified", "reference"], rows)
    page.add(
        "<h2>How well the models fit</h2>",
        "<p>Root-mean-square error in percent of the second, as in Table 1 of the paper.</p>",
    )
    names = ("reference_measured", "identified_measured", "reference_identified")
    fits = [
        [joint, *(f"{getattr(axis.rmse_percent, name):.2f}" for name in names)] for joint, axis in estimate.axes.items()
    ]
    head = ["axis", "reference − measurement", "identified − measurement", "reference − identified, workspace"]
    page.table(head, fits)
    parameters_section(page, estimate)


def _combination(page: ReportPage, combination: Combination) -> None:
    page.add(
        "<h2>Sweeps and trajectories together</h2>",
        "<p>The base parameters of the whole dynamics, SI, and what determines them.</p>",
    )
    rows = [
        [one.name, *with_std(one.value, one.std), one.reason or one.source, "" if one.identified else "not identified"]
        for one in combination.base_parameters
    ]
    page.table(["parameter", "value", "± std", "determined by", "not for use"], rows, "name")


def _suspects(page: ReportPage, suspects: Sequence[Suspect]) -> None:
    if not suspects:
        return
    page.add(
        "<h2>Sweeps that do not fit the others</h2>",
        "<p>No sweep is dropped; a sweep that fits worse has less weight.</p>",
    )
    rows = [[one.sweep, one.axis, one.why, f"{one.weight:.2g}"] for one in suspects]
    page.table(["sweep", "axis", "why", "weight"], rows)


def _check(page: ReportPage, check: DataCheck | None) -> None:
    page.add("<h2>Check of the data</h2>")
    if check is None:
        how = "the service checks the data at the end of a campaign, <code>sweepid check</code> checks a bundle"
        page.add(f"<p>Not done yet: {how}.</p>")
    elif not check.findings:
        page.add("<p>Nothing found.</p>")
    else:
        findings(page, check.findings)
