"""Data of the reports, read from the store: large data once, and samples of one sweep only."""

import hashlib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version

from pydantic import BaseModel, ConfigDict

from drivers.ports import AxisIdentity
from service import Conflict, NotFound
from service.identification.fleet.document import Fleet
from service.identification.motion.trajectory_record import runs_at_once
from service.jobs.work import DiagnosisReportJob, FleetReportJob, RecordedSweep, ReportJob
from service.model.causes import in_words
from service.model.results.diagnosis import DataCheck
from service.model.results.effect import ModelFile
from service.model.results.estimate import Estimate
from service.planning.campaigns.stored_plan import plan_subject
from service.planning.campaigns.stored_results import campaign_beside
from service.report.content import CampaignReport, Drive, example_of, used_sweeps
from service.report.html import Form
from service.store.diagnoses import DiagnosisStore
from service.store.documents import (
    CampaignDocument,
    DiagnosisDocument,
    EstimateDocument,
    RecordingDocument,
    SweepDocument,
    SweepState,
)
from service.store.files.recordings import RecordingFiles
from service.store.store import CheckStore, Store

CONVERGENCE = 100  # maximum number of revisions whose parameters are drawn


class _Manifest(BaseModel):
    """The part of a recording's manifest that the report uses; an imported recording has no drives."""

    model_config = ConfigDict(frozen=True, extra="ignore")
    drives: tuple[AxisIdentity, ...] = ()


@dataclass(frozen=True)
class Reporting:
    """Creates the jobs that draw reports. Methods block."""

    store: Store
    diagnoses: DiagnosisStore
    checks: CheckStore
    files: RecordingFiles

    def job(self, campaign_id: int, form: Form) -> ReportJob:
        """The report of a campaign with its latest estimate; Conflict if there is none, or one without content."""
        campaign = self.store.campaign(campaign_id)
        estimate = self._estimate(campaign)
        robot = self.store.robot(campaign.robot_id)
        own = self.store.sweeps(campaign_id)
        beside = campaign_beside(self.store, campaign)
        others = () if beside is None else self.store.sweeps(beside.id)
        alone = {sweep.spec.id: sweep for sweep in (*others, *own) if not runs_at_once(sweep.spec)}
        found = estimate.content
        specs = used_sweeps(found, [sweep.spec for sweep in alone.values()])
        diagnosis = self.diagnoses.newest_of(campaign_id)
        experiment = self.diagnoses.of_experiment(campaign_id)
        approved = None if experiment is None else experiment.experiment
        mass = None if approved is None else approved.test_mass
        identified = {sweep.number for sweep in own if sweep.state is SweepState.IDENTIFIED}
        recordings = [one for number, one in self.store.recordings(campaign_id).items() if number in identified]
        checked = self.checks.document(campaign_id)
        made = datetime.now(UTC)
        report = CampaignReport(
            title=f"Campaign {campaign_id}: the robot {robot.name}",
            subtitle=f"Identified from {len(recordings)} sweeps; revision {estimate.revision} of the estimate.",
            origin=(
                ("robot", f"{robot.name}, number {robot.id} of this service"),
                ("robot document", f"SHA-256 {robot.sha256}"),
                ("model", _model(found)),
                ("cell and machine", self._place(campaign)),
                ("campaign", _campaign(campaign)),
                ("ordered by", _ordered(campaign, None if approved is None else approved.approved_by)),
                ("measured", _measured(campaign)),
                ("estimate", f"revision {estimate.revision}, {_time(estimate.created_at)}"),
                *([] if beside is None else [("with the sweeps of", f"campaign {beside.id}")]),
                ("newest diagnosis", _diagnosis(diagnosis)),
                (
                    "recordings",
                    f"{len(recordings)}, SHA-256 {_listing(recordings)} of their list as sha256sum writes it",
                ),
                ("report", f"{_time(made)}, sweepid {version('sweepid')}"),
            ),
            drives=_drives(_Manifest.model_validate(self.files.manifest(one)) for one in recordings),
            check=None if checked is None else DataCheck.read(checked, f"data check of campaign {campaign_id}"),
            diagnosis=None if diagnosis is None else (diagnosis.id, diagnosis.found()),
            test_mass=None if mass is None else mass.mass,
        )
        return ReportJob(
            key=f"report-{form}-{campaign_id}-{estimate.revision}-{made.isoformat()}",
            robot=robot.description,
            urdf_text=robot.urdf_text,
            report=report,
            estimate=found,
            specs=specs,
            example=self._recorded(alone[example_of(specs).id]) if specs else None,
            revisions=tuple(
                self.store.base_parameters(campaign_id, spread(estimate.revision)).items() if specs else ()
            ),
            form=form,
        )

    def of_diagnosis(self, diagnosis_id: int, form: Form) -> DiagnosisReportJob:
        """The report of a diagnosis; Conflict until it is done."""
        diagnosis = self.diagnoses.diagnosis(diagnosis_id)
        found = diagnosis.found()
        robot = self.store.robot(diagnosis.robot_id)
        campaigns = ", ".join(str(number) for number in diagnosis.campaigns)
        made = datetime.now(UTC)
        finished = "" if diagnosis.finished_at is None else _time(diagnosis.finished_at)
        return DiagnosisReportJob(
            key=f"diagnosis-report-{form}-{diagnosis_id}-{made.isoformat()}",
            diagnosis=found,
            title=f"Diagnosis {diagnosis_id} of {robot.name}",
            subtitle=f"Campaigns {campaigns}",
            origin=(
                ("robot", f"{robot.name}, number {robot.id} of this service"),
                ("robot document", f"SHA-256 {robot.sha256}"),
                ("evidence", f"campaigns {campaigns}"),
                ("diagnosis", f"number {diagnosis_id}, {finished}"),
                ("report", f"{_time(made)}, sweepid {version('sweepid')}"),
            ),
            form=form,
        )

    def _place(self, campaign: CampaignDocument) -> str:
        """Cell of the plan, and the machine that ran it."""
        if campaign.plan_id is None:
            return f"cell not recorded (imported); machine {campaign.machine}"
        plan = self.store.plan(campaign.plan_id)
        subject = plan_subject(plan.robot_id, plan.document)
        return f"cell {subject.cell or 'not recorded'}, machine {campaign.machine}{subject.typed}"

    def _estimate(self, campaign: CampaignDocument) -> EstimateDocument:
        try:
            estimate = self.store.estimate(campaign.id)
        except NotFound:
            raise Conflict(
                f"campaign {campaign.id} ({campaign.state.value}) has no identified sweep yet, there is nothing to "
                "report"
            ) from None
        if not any(estimate.document.get(key) for key in ("axes", "analysis", "combination")):
            raise Conflict(
                f"campaign {campaign.id} ({campaign.state.value}): none of its identified sweeps shows an inertia, "
                "there is nothing to report"
            )
        return estimate

    def _recorded(self, sweep: SweepDocument) -> RecordedSweep:
        """BadInput if its file has changed since it was written."""
        return RecordedSweep(sweep.spec, self.files.named(self.store.recording(sweep.campaign_id, sweep.number)))


def of_fleet(fleet: Fleet, form: Form) -> FleetReportJob:
    """The report of the robots of a plant."""
    names = ", ".join(one.name for one in fleet.types) or "none"
    origin = (("types of robots", names), ("report", f"{_time(fleet.made_at)}, sweepid {version('sweepid')}"))
    return FleetReportJob(key=f"fleet-report-{form}-{fleet.made_at.isoformat()}", fleet=fleet, origin=origin, form=form)


def spread(last: int) -> Sequence[int]:
    """Revisions 1 ... `last`, thinned to the number that can be drawn; always with the last one."""
    if last <= CONVERGENCE:
        return range(1, last + 1)
    return sorted({1 + round(k * (last - 1) / (CONVERGENCE - 1)) for k in range(CONVERGENCE)})


def _model(estimate: Estimate) -> str:
    source = estimate.model
    if source is None:
        return "rigid body of the robot document; no accepted effects"
    named = (
        f"file {source.file}" if isinstance(source, ModelFile) else f"revision {source.revision} (number {source.id})"
    )
    return f"{named}, its effects taken into account"


def _campaign(campaign: CampaignDocument) -> str:
    states = ", ".join(f"{count} {state.value}" for state, count in campaign.sweeps.items())
    cause = f": {in_words(campaign.structured_cause)}" if campaign.structured_cause else ""
    plan = "imported" if campaign.plan_id is None else f"plan {campaign.plan_id}"
    return f"number {campaign.id}, {plan}, {campaign.state.value}{cause}; sweeps: {states}"


def _ordered(campaign: CampaignDocument, approved_by: str | None) -> str:
    if approved_by is not None:
        return f"{approved_by}, who approved it as the experiment of a diagnosis"
    return "not recorded" if campaign.plan_id is not None else "not recorded (imported)"


def _measured(campaign: CampaignDocument) -> str:
    if campaign.plan_id is None:
        return f"elsewhere; imported {_time(campaign.created_at)}"
    return "not started" if campaign.started_at is None else f"from {_time(campaign.started_at)}"


def _diagnosis(diagnosis: DiagnosisDocument | None) -> str:
    if diagnosis is None:
        return "none"
    campaigns = ", ".join(str(number) for number in diagnosis.campaigns)
    at = "" if diagnosis.finished_at is None else f", {_time(diagnosis.finished_at)}"
    return f"number {diagnosis.id}, of campaign {campaigns}{at}"


def _listing(recordings: Sequence[RecordingDocument]) -> str:
    """Output of `sha256sum FILE ... | sha256sum` in the data folder, with the files in the order of the sweeps."""
    text = "".join(f"{one.sha256}  {one.path}\n" for one in recordings)
    return hashlib.sha256(text.encode()).hexdigest()


def _drives(manifests: Iterable[_Manifest]) -> tuple[Drive, ...]:
    """Every identity that a drive reported, with its number of sweeps."""
    counted = Counter(drive for manifest in manifests for drive in manifest.drives)
    return tuple(Drive(**asdict(drive), sweeps=count) for drive, count in counted.items())


def _time(at: datetime) -> str:
    return f"{at:%Y-%m-%d %H:%M} UTC"
