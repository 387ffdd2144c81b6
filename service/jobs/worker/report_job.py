"""Jobs that draw reports in the worker: this takes seconds and would delay set-points."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from pydantic import JsonValue, TypeAdapter

from service.identification.fleet.document import Fleet
from service.jobs.worker.jobs import OfRobot, RecordedSweep
from service.model.recording import SweepSpec
from service.model.results.diagnosis import Diagnosis
from service.model.results.estimate import BaseParameter, Estimate

if TYPE_CHECKING:  # loaded when a report is drawn
    from service.model.errors import NoPdf
    from service.report import CampaignReport, Form, ReportPage

_PARAMETERS = TypeAdapter(tuple[BaseParameter, ...])


@dataclass(frozen=True, slots=True)
class ReportJob(OfRobot):
    """The report of an estimate.

    `specs`: of the sweeps whose inertia it contains, empty without axes; `example`: one of them. `revisions`:
    number and "base_parameters" of earlier revisions of the estimate.
    """

    report: "CampaignReport"
    estimate: Estimate
    specs: tuple[SweepSpec, ...]
    example: RecordedSweep | None
    revisions: tuple[tuple[int, JsonValue], ...]
    form: "Form"

    priority = 0

    def __call__(self) -> "Written":
        from service.report import campaign_page, content_of

        robot = self.built()
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
    """The report of a diagnosis. `origin`: names and values of the data that it was made from."""

    key: str
    diagnosis: Diagnosis
    title: str
    subtitle: str
    origin: tuple[tuple[str, str], ...]
    form: "Form"

    priority = 0

    def __call__(self) -> "Written":
        from service.report import diagnosis_page

        return _written(diagnosis_page(self.diagnosis, self.title, self.subtitle, self.origin), self.form)


@dataclass(frozen=True, slots=True)
class FleetReportJob:
    """The report of the robots of a plant. `origin`: names and values of its scope and of its program."""

    key: str
    fleet: Fleet
    origin: tuple[tuple[str, str], ...]
    form: "Form"

    priority = 0

    def __call__(self) -> "Written":
        from service.report import fleet_page

        return _written(fleet_page(self.fleet, self.origin), self.form)


Written: TypeAlias = "str | bytes | NoPdf"
"""A report, or the reason why it is not available in this form."""


def _written(page: "ReportPage", form: "Form") -> Written:
    from service.model.errors import NoPdf

    try:
        return page.written(form)
    except NoPdf as error:
        return error
