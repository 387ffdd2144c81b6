"""Documents returned by the store: frozen, one per row, ready to be sent as JSON.

The states are defined here because rows contain them. `service.planning.campaigns.state_machine` has the transitions.
"""

import hashlib
import json
from dataclasses import dataclass
from datetime import datetime
from enum import Enum
from typing import Annotated, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, JsonValue

from drivers.errors import Cause
from drivers.ports import SweepMode
from service import Conflict
from service.model import Robot, RobotDescription, SweepSpec, build_robot
from service.model.results.diagnosis import Diagnosis
from service.model.results.effect import ModelRevision
from service.model.results.estimate import Estimate
from service.model.results.part import JsonOf

LARGEST_ID = 2**31 - 1  # maximum of the integer column of every database


class CampaignState(Enum):
    """State of a campaign."""

    PLANNED = "planned"  # nothing has moved yet
    RUNNING = "running"  # owns the machine
    PAUSING = "pausing"  # paused after the present sweep
    PAUSED = "paused"  # waits for a person; reason in `cause`
    MEASURED = "measured"  # no sweep is left; identification may still run
    COMPLETED = "completed"  # everything is finished
    ABORTED = "aborted"  # ended by a person


class SweepState(Enum):
    """State of a sweep."""

    PLANNED = "planned"
    RUNNING = "running"  # its axis may move
    RECORDED = "recorded"  # complete samples on disk; this row is the durable identification job
    IDENTIFIED = "identified"  # an estimate revision contains it
    FAILED = "failed"  # ended by an error; reason in `cause`
    INTERRUPTED = "interrupted"  # stopped, or ended with the service
    SKIPPED = "skipped"  # not run: its campaign was aborted, or reached its confidence


class RecordingState(Enum):
    """Whether the samples are complete."""

    COMPLETE = "complete"
    PARTIAL = "partial"


class BatchState(Enum):
    """State of a batch. `waiting` and `running` are open: the next process continues them."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    CANCELLED = "cancelled"  # by a person; computed results are kept


class EventKind(Enum):
    """Subject of an event of the outbox."""

    CAMPAIGN = "campaign"  # {"state", "cause", "version"}
    SWEEP = "sweep"  # {"number", "state", "cause", "axis", "attempt"}
    CHECK_MOVE = "check_move"  # {"number", "axis", "way", "unit"}: before it is executed
    ESTIMATE = "estimate"  # {"revision", "sweep"}
    STOP = "stop"  # {"latched", "by", "why"}; belongs to no campaign
    DIAGNOSIS = "diagnosis"  # {"diagnosis", "state", "cause", "verdicts", "parent"}; belongs to no campaign
    BATCH = "batch"  # {"batch", "state", "done", "campaigns"}; belongs to no campaign
    DATA_CHECK = "data_check"  # {}: the findings of the campaign are stored


class StoredDocument(BaseModel):
    """What leaves the store."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class RobotDocument(StoredDocument):
    """A robot as stored; never changed (equal content has the same row)."""

    id: int
    name: str
    serial: str | None  # serial number; None: not in the file
    revision: str | None  # manufacturer's revision of the robot
    description: RobotDescription
    urdf_text: str
    created_at: datetime

    def build(self) -> Robot:
        return build_robot(self.description, self.urdf_text, f"robot {self.id}")

    @property
    def sha256(self) -> str:
        return robot_sha256(self.description, self.urdf_text)


class PlanRecord(StoredDocument):
    """A stored plan; `document` is the planner's PlanDocument as JSON."""

    id: int
    robot_id: int
    document: dict[str, JsonValue]
    created_at: datetime


class CampaignDocument(StoredDocument):
    """A campaign; `version` increases with every change of state (ETag), `plan_id` is None for an imported one.

    `machine`: the name of the machine that runs it, or whose service imported it. `here`: it is the machine of this
    service.
    """

    id: int
    machine: str
    here: bool
    robot_id: int
    plan_id: int | None
    state: CampaignState
    cause: str
    structured_cause: Cause | None = None
    version: int
    sweeps: dict[SweepState, int]  # number of sweeps by state; states without sweeps are omitted
    created_at: datetime
    started_at: datetime | None


class SweepDocument(StoredDocument):
    """A sweep of a campaign; once recorded, `spec` has the measured values (sample rate, window, start)."""

    campaign_id: int
    number: int  # 1, 2, ... in the order of the plan
    spec: SweepSpec
    mode: SweepMode | None  # None: imported
    state: SweepState
    cause: str
    structured_cause: Cause | None = None
    attempt: int  # 0 before the first run, +1 with every run


@dataclass(frozen=True, slots=True)
class SweepStatus:
    """State of a sweep, for frequent queries of all sweeps. `started_at` as in its spec, s."""

    number: int
    state: SweepState
    attempt: int
    started_at: float


class RecordingDocument(StoredDocument):
    """A recording file; `path` is relative to the data directory."""

    campaign_id: int
    number: int
    attempt: int
    state: RecordingState
    path: str
    sha256: str
    samples: int
    pruned_at: datetime | None = None  # its samples were removed by the retention rule


class Recorded(NamedTuple):
    """Recordings and their samples."""

    recordings: int
    samples: int


class EstimateDocument(StoredDocument):
    """Estimate revision n of a campaign, made when sweep `number` was identified; `document` as `identify --json`.

    In an imported campaign of more than 60 sweeps a revision contains several sweeps more than the one before it. Only
    the newest has `inertia`, the values of single sweeps: they would be the most of each revision's size.
    """

    campaign_id: int
    revision: int
    number: int
    document: Annotated[dict[str, JsonValue], JsonOf(Estimate)]
    created_at: datetime

    @property
    def content(self) -> Estimate:
        """Content of `document`. Raises BadInput if it is no estimate."""
        return Estimate.read(self.document, f"estimate {self.revision} of campaign {self.campaign_id}")


class EventDocument(StoredDocument):
    """One entry of the outbox; ids increase."""

    id: int
    campaign_id: int | None
    kind: EventKind
    data: dict[str, JsonValue]
    at: datetime


class StopDocument(StoredDocument):
    """A stop command; the machine is latched while `reset_at` is None. `cause`: None if a person stopped it."""

    id: int
    by: str
    why: str
    cause: Cause | None = None
    at: datetime
    reset_by: str | None
    reset_at: datetime | None


class StoredAnswer(StoredDocument):
    """The answer already given to a request with this idempotency key."""

    status: int
    body: str


class NewSweep(StoredDocument):
    """A sweep to be planned."""

    spec: SweepSpec
    mode: SweepMode | None


class NewRecording(StoredDocument):
    """A recording file that was just written."""

    state: RecordingState
    path: str
    sha256: str
    samples: int


class SpectrumRecord(StoredDocument):
    """The file of an identified sweep's spectrum; `path` is relative to the data directory."""

    path: str
    sha256: str


def robot_sha256(description: RobotDescription, urdf_text: str) -> str:
    """Hash of description and URDF: equal content has the same hash."""
    content = json.dumps([description.model_dump(mode="json"), urdf_text], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()


class DiagnosisState(Enum):
    """State of a diagnosis. `waiting` and `running` are open jobs: the next process continues them."""

    WAITING = "waiting"
    RUNNING = "running"  # passed to the workers
    DONE = "done"
    FAILED = "failed"  # reason in `cause`


class BoltedMass(StoredDocument):
    """A known mass on the last link: kg, m and kg m^2 in the frame of that link's joint.

    `inertia` (Ixx, Ixy, Iyy, Ixz, Iyz, Izz) about its centre of mass, along the axes of that frame.
    """

    model_config = ConfigDict(allow_inf_nan=False)
    mass: float = Field(gt=0)
    center: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Weighing(StoredDocument):
    """The campaign measured with a known mass, and the mass."""

    campaign_id: int
    mass: BoltedMass


class EstimateOf(StoredDocument):
    """Revision n of a campaign's estimate."""

    campaign_id: int
    revision: int

    @property
    def name(self) -> str:
        """Text as in `started_from`."""
        return f"campaign {self.campaign_id}, revision {self.revision}"


class ExperimentDocument(StoredDocument):
    """The approved next experiment of one axis; `test_mass` is mounted while it is measured."""

    axis: str
    campaign_id: int
    approved_by: str
    at: datetime
    test_mass: BoltedMass | None


class NewDiagnosis(StoredDocument):
    """Input of a diagnosis: axes of one robot, from all complete sweeps of `campaigns`.

    `model`: accepted model to start from. `estimate`: start of the rigid model, None: CAD. `weighed`: a campaign
    with a known mass, in addition to those without. `parent`: the diagnosis that this one continues. `unattended`:
    proposed experiments are run without approval.
    """

    robot_id: int = Field(ge=1, le=LARGEST_ID)
    campaigns: tuple[int, ...]
    axes: tuple[str, ...]
    model: int | None = None
    estimate: EstimateOf | None = None
    weighed: Weighing | None = None
    parent: int | None = None
    unattended: bool = False


class DiagnosisEntry(NewDiagnosis):
    """A diagnosis in a list; `verdicts` of the finished axes.

    `machine`: the name of the machine whose service computes it. `here`: it is the machine of this service.
    """

    id: int
    machine: str
    here: bool
    state: DiagnosisState
    cause: str
    verdicts: dict[str, str]
    experiment: ExperimentDocument | None
    created_at: datetime
    finished_at: datetime | None


class DiagnosisDocument(DiagnosisEntry):
    """A diagnosis; `document` as `sweepid diagnose --json` prints it, once it is done."""

    document: Annotated[dict[str, JsonValue], JsonOf(Diagnosis)] | None

    def found(self, to_do: str = "show") -> Diagnosis:
        """Content of `document`. Raises Conflict if it is not done (`to_do`: action in the message), BadInput."""
        if self.document is None:
            raise Conflict(f"diagnosis {self.id} is {self.state.value}, there is nothing to {to_do} yet")
        return Diagnosis.read(self.document, f"diagnosis {self.id}")


class ModelDocument(StoredDocument):
    """Revision n of a robot's model: rigid body and effects, as accepted from a diagnosis; never changed.

    `parent`: the previous revision, which provides the axes that are not part of this one.
    """

    id: int
    robot_id: int
    revision: int
    parent: int | None
    diagnosis_id: int
    accepted_by: str
    at: datetime
    document: Annotated[dict[str, JsonValue], JsonOf(ModelRevision)]

    @property
    def content(self) -> ModelRevision:
        """Content of `document`. Raises BadInput if it is no model."""
        return ModelRevision.read(self.document, f"model {self.id}")
