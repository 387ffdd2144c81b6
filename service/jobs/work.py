"""Jobs of the workers (identification, diagnosis, data check, reports), and the interface of who does them.

A job refers to files and contains no samples and no spectra; the files are named by their content. The result depends
only on that content, so a job that is repeated after its worker was killed gives the same result (a revision before the
last one within the limits of `Revisions`). The durable job is the row of the sweep or of the diagnosis. A worker keeps
the spectra that it has read, because the next revision of a long campaign may need them again.

The numerical libraries are loaded by the first job that needs them: a process that only submits jobs does not load
them, and an idle worker needs few resources.
"""

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Protocol, TypeAlias, TypeVar

import structlog
from pydantic import JsonValue, TypeAdapter
from structlog.contextvars import bound_contextvars

from service import NoPdf, SweepidError
from service.identification.fleet.document import Fleet
from service.model import Robot, RobotDescription, Sweep, SweepSpec, build_robot
from service.model.results.diagnosis import AxisDiagnosis, DataCheck, Diagnosis
from service.model.results.effect import KnownModel, StoredModel
from service.model.results.estimate import Analyses, BaseParameter, Estimate
from service.model.results.spectrum import AnySpectrum
from service.process.tasks import give_way
from service.process.telemetry import TRACING
from service.store.documents import ModelDocument
from service.store.files.recordings import SpectrumFile, read_spectrum

if TYPE_CHECKING:  # numerical modules, and the report
    from service.diagnosis.fit.fitted import Parameter
    from service.identification.axis.known_effects import KnownEffects
    from service.identification.estimates.robot_type import RobotType
    from service.identification.estimates.torque_gain import KnownMass
    from service.identification.estimates.update import Condensed
    from service.identification.estimation import SweepSpectrum
    from service.planning.diagnosis import ExperimentPlace
    from service.report.content import CampaignReport
    from service.report.html import Form, ReportPage
    from service.store.files.recordings import RecordingFile

_log = structlog.get_logger(__name__)

TRACEPARENT = "traceparent"
Answer = TypeVar("Answer", covariant=True)


class Work(Protocol[Answer]):
    """A job of any kind."""

    @property
    def key(self) -> str:
        """Equal work has an equal key."""
        ...

    @property
    def priority(self) -> int:
        """Jobs with a higher number run first."""
        ...

    def __call__(self) -> Answer:
        """Do the job and return its result."""
        ...


class JobFailed(SweepidError):
    """The job failed, and would fail again: the message gives the reason."""


class WorkerLost(SweepidError):
    """No worker can do the job now, or the job was lost: it can be submitted again."""


class Worker(ABC):
    """One local process, or the workers of a cluster."""

    trouble: str = ""
    """Why no job can be done now; empty if no reason is known."""

    @abstractmethod
    async def run(self, job: Work[Answer]) -> Answer:
        """The result of a job. JobFailed, WorkerLost, or the job's own NotNow.

        A worker that has died is replaced, and its job is repeated.
        """

    @abstractmethod
    async def processes(self) -> tuple[int, ...]:
        """Process ids of the workers; WorkerLost while no worker answers."""

    @abstractmethod
    async def close(self) -> None:
        """Cancel all jobs."""

    async def run_patiently(self, job: Work[Answer]) -> Answer:
        """As `run`, repeated until a worker answers; JobFailed or NotNow."""
        while True:
            try:
                return await self.run(job)
            except WorkerLost as error:
                _log.warning("worker_lost", reason=str(error))
                await asyncio.sleep(2.0)  # between attempts to reach the workers


def work(job: Work[Answer], about: Mapping[str, object] = MappingProxyType({})) -> Answer:
    """Do a job. Runs in the worker process. `about`: fields of its log lines, as in the log of the caller, and the
    span to which it belongs.
    """
    give_way()
    lines = {name: value for name, value in about.items() if name != TRACEPARENT}
    parent = str(about.get(TRACEPARENT, ""))
    with bound_contextvars(job=job.key, **lines), TRACING.span(type(job).__name__, parent, job=job.key):
        return job()


@dataclass(frozen=True, slots=True)
class RecordedSweep:
    """A sweep with its samples in a file or in the object store."""

    spec: SweepSpec
    file: "RecordingFile"

    def read(self) -> Sweep:
        from service.store.objects import read_recording

        return Sweep(self.spec, read_recording(self.file))


@dataclass(frozen=True, slots=True)
class OfRobot:
    """What every job about a robot has."""

    key: str
    robot: RobotDescription
    urdf_text: str

    def built(self) -> Robot:
        return build_robot(self.robot, self.urdf_text)


@dataclass(frozen=True, slots=True)
class Job(OfRobot):
    """Identify recorded sweeps and, with the spectra of the sweeps before them, the robot."""

    sweeps: tuple[RecordedSweep, ...]
    earlier: tuple[SpectrumFile, ...]
    analyses: Analyses  # of the campaign that the plan names; {} without one
    siblings: Mapping[str, Estimate]  # of the other robots of the type that it names; {} without
    model: ModelDocument | None = None  # the robot's model; None: it has none yet
    last: bool = True  # no sweep follows: all are fitted at once

    priority = 1  # a running campaign may end when its confidence is reached

    def __call__(self) -> "Result":
        from service.identification.estimation import sweep_spectrum

        robot = self.built()
        new = [sweep_spectrum(robot, sweep.read()) for sweep in self.sweeps]
        return Result(tuple(spectrum.to_document() for spectrum in new), _REVISIONS.next(self, robot, new))


class Revisions:
    """The last revision of a worker, condensed for the next one of the same campaign: that one need not fit all sweeps.

    A revision by update is within 0.01 standard deviations of the fit of all sweeps, which the last one always is.
    """

    def __init__(self) -> None:
        self._kept: _Kept | None = None

    def next(self, job: Job, robot: Robot, new: "Sequence[SweepSpectrum]") -> dict[str, JsonValue]:
        """The estimate of a job with `new` spectra."""
        from service.identification.estimates.initial_analysis import analyses_from
        from service.identification.estimation import condensed_estimate, estimate_document, updated_estimate

        kept, self._kept = self._kept, None
        inputs = (job.robot, job.urdf_text, job.analyses, job.siblings, job.model)
        if kept is not None and not job.last and kept.inputs == inputs and kept.made_from(job.earlier):
            condensed = updated_estimate(kept.condensed, new)
            if condensed is not None:
                self._kept = _Kept(inputs, frozenset(job.earlier), tuple(new), condensed)
                return condensed.document.as_json()
        spectra = [*map(_spectrum, job.earlier), *new]
        analyses, known = analyses_from(job.analyses), _known(job.model, robot)
        if job.last or job.siblings:
            return estimate_document(
                robot, spectra, analyses, known=known, earlier=_of_type(robot, job.siblings)
            ).as_json()
        found, condensed = condensed_estimate(robot, spectra, analyses, known)
        if condensed is not None:
            self._kept = _Kept(inputs, frozenset(job.earlier), tuple(new), condensed)
        return found.as_json()


@dataclass(frozen=True, slots=True)
class _Kept:
    """A revision; `earlier` and `new` as in its job."""

    inputs: tuple[object, ...]
    earlier: frozenset[SpectrumFile]
    new: "tuple[SweepSpectrum, ...]"
    condensed: "Condensed"

    def made_from(self, files: "Sequence[SpectrumFile]") -> bool:
        """Whether it was made from the content of these files."""
        added = [_spectrum(file).to_document() for file in files if file not in self.earlier]
        whole = len(files) == len(self.earlier) + len(self.new)
        return whole and added == [spectrum.to_document() for spectrum in self.new]


_REVISIONS = Revisions()


def _of_type(robot: Robot, siblings: Mapping[str, Estimate]) -> "RobotType | None":
    from service.identification.estimates.robot_type import robot_type

    return robot_type(robot, siblings) if siblings else None


def _known(model: ModelDocument | None, robot: Robot) -> "KnownEffects | None":
    """The effects of the robot's model."""
    from service.identification.axis.known_effects import known_effects

    if model is None:
        return None
    source = StoredModel(id=model.id, revision=model.revision)
    return known_effects(KnownModel.read(model.document, "model"), robot.joints, source)


@lru_cache(maxsize=2048)  # about 10 kB each; a paper's campaign has 900
def _spectrum(file: SpectrumFile) -> "SweepSpectrum":
    """A file is named by its content, so the cached spectrum of a file is always valid."""
    from service.identification.estimation import spectrum_from

    return spectrum_from(read_spectrum(file))


@dataclass(frozen=True, slots=True)
class Result:
    """`to_document()` of the spectrum of each sweep, in their order, and the `estimate_document` with them."""

    spectra: tuple[AnySpectrum, ...]
    estimate: dict[str, JsonValue]


@dataclass(frozen=True, slots=True)
class DiagnosisJob(OfRobot):
    """Diagnose one axis; `known`: effects of the model with its parameters; `weighed`: sweeps with a known `mass`."""

    joint: str
    sweeps: tuple[RecordedSweep, ...]
    known: "Mapping[str, Mapping[str, Parameter]]"
    mass: "KnownMass | None"
    weighed: tuple[RecordedSweep, ...]
    estimate: Mapping[str, JsonValue] | None = None  # document from which the rigid model starts; None: CAD
    started_from: str = ""  # name of that estimate
    experiments: int = 0  # of the axis that led to it
    place: "ExperimentPlace | None" = None  # where the next would run; None: not known

    priority = 0

    def __call__(self) -> AxisDiagnosis:
        from service.diagnosis import axis_document, diagnose_axis
        from service.diagnosis.experiments import all_runnable
        from service.diagnosis.fit.calibration import Weighed
        from service.formats.export.started_robot import started_from

        origin = robot = self.built()
        if self.estimate is not None:
            robot = started_from(robot, self.estimate, self.started_from)
        sweeps = [sweep.read() for sweep in self.sweeps]
        weighed = None
        if self.mass is not None:
            weighed = Weighed(self.mass, tuple(sweep.read() for sweep in self.weighed))
        runnable = all_runnable if self.place is None else partial(self.place.runnable, origin)
        return axis_document(
            diagnose_axis(
                robot, self.joint, sweeps, known=self.known, weighed=weighed, experiments=self.experiments,
                runnable=runnable,
            )
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class ReidentifyJob(OfRobot):
    """Identify all sweeps of a campaign again. `before`: document of its stored estimate, {} if there is none."""

    sweeps: tuple[RecordedSweep, ...]
    analyses: Analyses
    siblings: Mapping[str, Estimate]
    model: ModelDocument | None
    before: Mapping[str, JsonValue]

    priority = -1  # after all jobs for which a person waits

    def __call__(self) -> "BatchResult":
        from service.identification.estimates.initial_analysis import analyses_from
        from service.identification.estimation import estimate_document, sweep_spectrum
        from service.store.files.recordings import check_file

        robot = self.built()
        for sweep in self.sweeps:
            if sweep.file.store is None:
                check_file(sweep.file.path, sweep.file.sha256)
        spectra = [sweep_spectrum(robot, sweep.read()) for sweep in self.sweeps]
        analyses, known = analyses_from(self.analyses), _known(self.model, robot)
        found = estimate_document(robot, spectra, analyses, known=known, earlier=_of_type(robot, self.siblings))
        before = Estimate.read(self.before, "stored estimate") if self.before else None
        return BatchResult(found.as_json(), len(spectra), _largest_change(before, found))


@dataclass(frozen=True, slots=True)
class BatchResult:
    """The document. `change_percent`: largest change of J of any sweep from the stored estimate, percent."""

    document: dict[str, JsonValue]
    sweeps: int
    change_percent: float | None = None


@dataclass(frozen=True, slots=True)
class PayloadJob(OfRobot):
    """Identify the payload that was mounted in the sweeps `after` and not in `before`."""

    before: tuple[RecordedSweep, ...]
    after: tuple[RecordedSweep, ...]

    priority = 0

    def __call__(self) -> BatchResult:
        from service.identification.payloads import payload, payload_document

        robot = self.built()
        before, after = ([sweep.read() for sweep in part] for part in (self.before, self.after))
        return BatchResult(payload_document(robot, payload(robot, before, after)).as_json(), len(after))


def _largest_change(before: Estimate | None, now: Estimate) -> float | None:
    """None if no sweep has an inertia in both."""
    old = {} if before is None else {(k, one.sweep): one.value for k, a in before.axes.items() for one in a.inertia}
    new = {(joint, one.sweep): one.value for joint, axis in now.axes.items() for one in axis.inertia}
    changes = [100 * abs(new[key] / value - 1) for key, value in old.items() if key in new and value]
    return max(changes, default=None)


@dataclass(frozen=True, slots=True)
class CheckJob(OfRobot):
    """Check the data of sweeps, before the identification."""

    sweeps: tuple[RecordedSweep, ...]

    priority = 0

    def __call__(self) -> DataCheck:
        from service.data_check import check, findings_document

        robot = self.built()
        sweeps = [sweep.read() for sweep in self.sweeps]
        return findings_document(robot, sweeps, check(robot, sweeps))


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
        from service.report.campaign import campaign_page
        from service.report.content import content_of

        robot = self.built()
        content = None
        if self.example is not None:
            example, parameters = self.example, TypeAdapter(tuple[BaseParameter, ...])
            content = content_of(
                robot,
                self.estimate,
                self.specs,
                lambda _: example.read(),
                self.report.subtitle,
                revisions=[(number, parameters.validate_python(found)) for number, found in self.revisions],
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
        from service.report.diagnosis import diagnosis_page

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
        from service.report.fleet import fleet_page

        return _written(fleet_page(self.fleet, self.origin), self.form)


Written: TypeAlias = "str | bytes | NoPdf"
"""A report, or the reason why it is not available in this form."""


def _written(page: "ReportPage", form: "Form") -> Written:
    try:
        return page.written(form)
    except NoPdf as error:
        return error
