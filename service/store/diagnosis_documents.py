"""What the store hands out of diagnoses and of the models that people accept from them."""

from datetime import datetime
from enum import Enum
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, JsonValue

from service.errors import Conflict
from service.results.described import JsonOf
from service.results.diagnosis import Diagnosis
from service.results.revision import ModelRevision
from service.store.documents import LARGEST_ID


class DiagnosisState(Enum):
    """Where a diagnosis stands. `waiting` and `running` are open jobs: the next process takes them up again."""

    WAITING = "waiting"
    RUNNING = "running"  # handed to the workers
    DONE = "done"
    FAILED = "failed"  # `cause` says why


class _Document(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class BoltedMass(_Document):
    """A known mass on the last link: kg, m and kg m^2 in the frame of that link's joint.

    `inertia` (Ixx, Ixy, Iyy, Ixz, Iyz, Izz) about its centre of mass, along the axes of that frame.
    """

    mass: float = Field(gt=0)
    center: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Weighing(_Document):
    """The campaign that was measured with a known mass, and the mass."""

    campaign_id: int
    mass: BoltedMass


class EstimateOf(_Document):
    """Revision n of a campaign's estimate."""

    campaign_id: int
    revision: int

    @property
    def name(self) -> str:
        """In words, as `started_from` has it."""
        return f"campaign {self.campaign_id}, revision {self.revision}"


class ExperimentDocument(_Document):
    """The next experiment of one axis as it was approved; `test_mass` is bolted on while it is measured."""

    axis: str
    campaign_id: int
    approved_by: str
    at: datetime
    test_mass: BoltedMass | None


class NewDiagnosis(_Document):
    """What is to be diagnosed: axes of one robot, from all complete sweeps of `campaigns`.

    `model`: accepted model to start from. `estimate`: from which the rigid model starts, None: CAD. `weighed`: a
    campaign with a known mass beside those without. `parent`: the diagnosis that this one continues. `unattended`:
    proposed experiments are run without anybody's approval.
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
    """A diagnosis in a list; `verdicts` of the axes that are done."""

    id: int
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
        """What `document` says; Conflict while there is nothing `to_do`, BadInput where it is no diagnosis."""
        if self.document is None:
            raise Conflict(f"diagnosis {self.id} is {self.state.value}, there is nothing to {to_do} yet")
        return Diagnosis.read(self.document, f"diagnosis {self.id}")


class ModelDocument(_Document):
    """Revision n of a robot's model: rigid body and effects, as somebody accepted it from a diagnosis; never changed.

    `parent`: the revision before, of which the axes that this one is not about are.
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
        """What `document` says; BadInput where it is no model."""
        return ModelRevision.read(self.document, f"model {self.id}")
