"""The report of a campaign, drawn in the worker: it takes seconds that would delay set-points."""

from dataclasses import dataclass

from pydantic import JsonValue, TypeAdapter

from service.recording import SweepSpec
from service.report import CampaignReport, content_of, render_campaign
from service.results.estimate import BaseParameter, Estimate
from service.robot import RobotDescription, build_robot
from service.worker.jobs import RecordedSweep

_PARAMETERS = TypeAdapter(tuple[BaseParameter, ...])


@dataclass(frozen=True, slots=True)
class ReportJob:
    """One HTML file of an estimate.

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

    @property
    def priority(self) -> int:
        return 0

    def __call__(self) -> str:
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
        return render_campaign(self.report, robot, self.estimate, content)
