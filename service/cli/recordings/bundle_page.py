"""The report of a bundle: what a campaign of the service tells as well, without its drives and diagnoses."""

from datetime import UTC, datetime
from importlib.metadata import version

from service.data_check import check, findings_document
from service.model.errors import BadInput
from service.model.results.check import DataCheck
from service.model.results.estimate import Estimate
from service.report import CampaignReport, ReportPage, campaign_page, content_of, used_sweeps
from service.store.files.bundle import Bundle


def bundle_page(bundle: Bundle, found: Estimate, place: str) -> ReportPage:
    """Of an estimate that was made of the bundle; BadInput if it holds nothing to report."""
    if not (found.axes or found.analysis or found.combination):
        raise BadInput(place, "has neither sweeps of one axis nor an initial analysis to report")
    sweeps = {sweep.spec.id: sweep for sweep in bundle.sweeps}
    specs = used_sweeps(found, [sweep.spec for sweep in bundle.sweeps])
    subtitle = f"Identified from {len(specs) or len(sweeps)} sweeps of the bundle {place}."
    findings = check(bundle.robot, bundle.sweeps)
    report = CampaignReport(
        title=f"Inertias of the robot {bundle.robot.name}",
        subtitle=subtitle,
        origin=(("robot", bundle.robot.name), ("bundle", place), ("report", made_now())),
        drives=(),
        check=DataCheck.read(findings_document(bundle.robot, bundle.sweeps, findings), place),
        diagnosis=None,
    )
    content = content_of(bundle.robot, found, specs, lambda spec: sweeps[spec.id], subtitle) if specs else None
    return campaign_page(report, bundle.robot.joints, found, content)


def made_now() -> str:
    """When, and by which version."""
    return f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, sweepid {version('sweepid')}"
