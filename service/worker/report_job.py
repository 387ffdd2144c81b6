"""Reports, drawn in the worker: they take seconds that would delay set-points."""

from dataclasses import dataclass

from pydantic import JsonValue, TypeAdapter

from service.recording import SweepSpec
from service.report import CampaignReport, Form, NoPdf, Page, campaign_page, content_of, diagnosis_page
from service.results.diagnosis import Diagnosis
from service.results.estimate import BaseParameter, Estimate
from service.robot import RobotDescription, build_robot
from service.worker.jobs import RecordedSweep

_PARAMETERS = TypeAdapter(tuple[BaseParameter, ...])


@dataclass(frozen=True, slots=True)
class ReportJob:
    """Of an estimate.

    `specs`: of the sweeps whose inertia it has, none where it has no axis; `example` is one of them. `revisions`:
    number and "base_parameters" of estimates on the way.
    """

    key: str
    robot: RobotDescription
    urdf_text: str
    report: CampaignReport
    estimate: Estimate
    specs: tuple[SweepSpec, ...]
    example: RecordedSweep | None
    revisions: tuple[tuple[int, JsonValue], ...]
    form: Form

    @property
    def priority(self) -> int:
        return 0

    def __call__(self) -> "Written":
        robot = build_robot(self.robot, self.urdf_text)
        content = None
        if self.example is not None:
            example = self.example
            content = content_of(
                robot,
                self.estimate,
                self.specs,
                lambda _: example.read(),
                self.report.subtitle,
                revisions=[(number, _PARAMETERS.validate_python(found)) for number, found in self.revisions],
            )
        return _written(campaign_page(self.report, robot.joints, self.estimate, content), self.form)


@dataclass(frozen=True, slots=True)
class DiagnosisReportJob:
    """Of a diagnosis. `origin`: what, and what is known of it."""

    key: str
    diagnosis: Diagnosis
    title: str
    subtitle: str
    origin: tuple[tuple[str, str], ...]
    form: Form

    @property
    def priority(self) -> int:
        return 0

    def __call__(self) -> "Written":
        return _written(diagnosis_page(self.diagnosis, self.title, self.subtitle, self.origin), self.form)


Written = str | bytes | NoPdf
"""A report, or why there is none in its form."""


def _written(page: Page, form: Form) -> Written:
    try:
        return page.written(form)
    except NoPdf as error:
        return error
