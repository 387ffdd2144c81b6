"""The report of what lies in files: a bundle, or what another command wrote with `--json`."""

import hashlib
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from pydantic import Field

import sweepid
from service import BadInput
from service.data_check import check, findings_document
from service.model.results.diagnosis import Diagnosis
from service.model.results.estimate import Estimate
from service.model.results.part import Document, Part
from service.report.campaign import campaign_page
from service.report.content import CampaignReport, content_of, used_sweeps
from service.report.diagnosis import diagnosis_page
from service.report.html import ReportPage
from service.store.files.bundle import Bundle
from sweepid.files import read_document


def result_page(path: Path) -> ReportPage:
    """Of a bundle (then identified and checked), an estimate, an initial analysis or a diagnosis; BadInput if none."""
    if path.is_dir():
        bundle = sweepid.read_bundle(path)
        return bundle_page(bundle, sweepid.identify(bundle), str(path))
    some = read_document(path, _Some)
    if any(axis.verdict is not None for axis in some.axes.values()):
        found = read_document(path, Diagnosis)
        robot = found.model.robot
        return diagnosis_page(found, f"Diagnosis of the robot {robot}", str(path), (("robot", robot), *_origin(path)))
    if not (some.axes or some.analysis or some.combination):
        raise BadInput(str(path), "is not a result of `sweepid identify --json` or `sweepid diagnose --json`")
    return _estimate_page(read_document(path, Estimate), path)


class _SomeAxis(Part):
    verdict: object = None


class _Some(Document):
    """What tells which kind of result a file has."""

    axes: Mapping[str, _SomeAxis] = Field(default={})
    analysis: object = None
    combination: object = None


def _estimate_page(found: Estimate, path: Path) -> ReportPage:
    """Tables alone: what the figures are drawn of are the sweeps, which a result does not have."""
    report = CampaignReport(
        title="Estimate" if found.axes or found.combination else "Initial analysis",
        subtitle=f"Of the file {path.name}, without its sweeps.",
        origin=tuple(_origin(path)),
        drives=(),
        check=None,
        diagnosis=None,
    )
    return campaign_page(report, sorted(found.analysis), found, None)


def _origin(path: Path) -> list[tuple[str, str]]:
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return [("file", str(path)), ("content", f"SHA-256 {digest}"), ("report", made_now())]


def bundle_page(bundle: Bundle, found: Estimate, place: str) -> ReportPage:
    """Of an estimate that was made of the bundle; BadInput if it holds nothing to report."""
    if not (found.axes or found.analysis or found.combination):
        raise BadInput(place, "has neither sweeps of one axis nor an initial analysis to report")
    sweeps = {sweep.spec.id: sweep for sweep in bundle.sweeps}
    specs = used_sweeps(found, [sweep.spec for sweep in bundle.sweeps])
    subtitle = f"Identified from {len(specs) or len(sweeps)} sweeps of the bundle {place}."
    report = bundle_report(bundle, place, subtitle)
    content = content_of(bundle.robot, found, specs, lambda spec: sweeps[spec.id], subtitle) if specs else None
    return campaign_page(report, bundle.robot.joints, found, content)


def bundle_report(bundle: Bundle, place: str, subtitle: str) -> CampaignReport:
    """Origin and data check of a bundle that lies in the folder `place`."""
    files = sorted(path for path in Path(place).rglob("*") if path.is_file())
    listing = "".join(
        f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.relative_to(place).as_posix()}\n" for file in files
    )
    findings = check(bundle.robot, bundle.sweeps)
    return CampaignReport(
        title=f"Inertias of the robot {bundle.robot.name}",
        subtitle=subtitle,
        origin=(
            ("robot", bundle.robot.name),
            ("bundle", place),
            (
                "files",
                f"{len(files)}, SHA-256 {hashlib.sha256(listing.encode()).hexdigest()} of their list as sha256sum "
                "writes it",
            ),
            ("report", made_now()),
        ),
        drives=(),
        check=findings_document(bundle.robot, bundle.sweeps, findings),
        diagnosis=None,
    )


def made_now() -> str:
    """When, and by which version."""
    return f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, sweepid {version('sweepid')}"
