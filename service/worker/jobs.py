"""What is done in the worker: identification, diagnosis, the check of data.

A job refers to files and carries no samples and no spectra: what it reads there is named by its content. It is a
function of that content alone, so that a killed worker's job gives the same result when it is done again. Nothing is
kept here: the durable job is the row of the sweep or of the diagnosis.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

from pydantic import JsonValue

from service.data_check import check, findings_document
from service.diagnosis import axis_document, diagnose_axis, started_from
from service.diagnosis.fit.calibration import Weighed
from service.diagnosis.fit.parameters import Parameter
from service.estimation import estimate_document, spectrum_from, sweep_spectrum
from service.identification.axis.known_effects import known_effects
from service.identification.estimates.analysis_document import analyses_from
from service.identification.estimates.torque_gain import KnownMass
from service.recording import Sweep, SweepSpec
from service.results.analysis import Analyses
from service.results.identified.spectrum import AnySpectrum
from service.results.revision import KnownModel, StoredModel
from service.robot import RobotDescription, build_robot
from service.store.diagnosis_documents import ModelDocument
from service.store.files.columns import read_columns
from service.store.files.spectra import SpectrumFile, read_spectrum

Answer = TypeVar("Answer", covariant=True)


class Work(Protocol[Answer]):
    """A job of any kind."""

    @property
    def key(self) -> str:
        """The same work has the same key."""
        ...

    @property
    def priority(self) -> int:
        """What waits in the workers' queue gives way to more."""
        ...

    def __call__(self) -> Answer:
        """Do it."""
        ...


@dataclass(frozen=True, slots=True)
class Job:
    """Identify one recorded sweep and, with the spectra of the sweeps before it, the robot. Paths are absolute."""

    key: str
    robot: RobotDescription
    urdf_text: str
    spec: SweepSpec
    path: Path
    earlier: tuple[SpectrumFile, ...]
    analyses: Analyses  # of the campaign that the plan names, {} if it names none
    model: ModelDocument | None = None  # the robot's; None: it has none yet

    @property
    def priority(self) -> int:
        return 1  # the campaign that is under way may end when enough is known

    def __call__(self) -> "Result":
        robot = build_robot(self.robot, self.urdf_text)
        new = sweep_spectrum(robot, Sweep(self.spec, read_columns(self.path)))
        earlier = [spectrum_from(read_spectrum(file)) for file in self.earlier]
        known = None
        if self.model is not None:
            source = StoredModel(id=self.model.id, revision=self.model.revision)
            known = known_effects(KnownModel.read(self.model.document, "model"), robot.joints, source)
        analyses = analyses_from(self.analyses)
        return Result(new.to_document(), estimate_document(robot, [*earlier, new], analyses, known=known).as_json())


@dataclass(frozen=True, slots=True)
class Result:
    """`to_document()` of the sweep's spectrum and `estimate_document` with it."""

    spectrum: AnySpectrum
    estimate: dict[str, JsonValue]


@dataclass(frozen=True, slots=True)
class RecordedSweep:
    """A sweep whose samples lie in a file."""

    spec: SweepSpec
    path: Path

    def read(self) -> Sweep:
        return Sweep(self.spec, read_columns(self.path))


@dataclass(frozen=True, slots=True)
class DiagnosisJob:
    """Diagnose one axis; `known`: effects of the model with its parameters; `weighed`: sweeps with a known `mass`."""

    key: str
    robot: RobotDescription
    urdf_text: str
    joint: str
    sweeps: tuple[RecordedSweep, ...]
    known: Mapping[str, Mapping[str, Parameter]]
    mass: KnownMass | None
    weighed: tuple[RecordedSweep, ...]
    estimate: Mapping[str, JsonValue] | None = None  # document from which the rigid model starts; None: CAD
    started_from: str = ""  # which estimate that is

    @property
    def priority(self) -> int:
        return 0

    def __call__(self) -> dict[str, JsonValue]:
        robot = build_robot(self.robot, self.urdf_text)
        if self.estimate is not None:
            robot = started_from(robot, self.estimate, self.started_from)
        sweeps = [sweep.read() for sweep in self.sweeps]
        weighed = None
        if self.mass is not None:
            weighed = Weighed(self.mass, tuple(sweep.read() for sweep in self.weighed))
        return axis_document(diagnose_axis(robot, self.joint, sweeps, known=self.known, weighed=weighed))


@dataclass(frozen=True, slots=True)
class CheckJob:
    """Check the data of sweeps, before any physics."""

    key: str
    robot: RobotDescription
    urdf_text: str
    sweeps: tuple[RecordedSweep, ...]

    @property
    def priority(self) -> int:
        return 0

    def __call__(self) -> dict[str, JsonValue]:
        robot = build_robot(self.robot, self.urdf_text)
        sweeps = [sweep.read() for sweep in self.sweeps]
        return findings_document(robot, sweeps, check(robot, sweeps))
