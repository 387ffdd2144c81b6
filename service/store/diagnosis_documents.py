"""Documents of diagnoses and of the models accepted from them."""

from datetime import datetime
from enum import Enum
from typing import Annotated

from pydantic import ConfigDict, Field, JsonValue

from service.model.errors import Conflict
from service.model.results.diagnosis import Diagnosis
from service.model.results.effect import ModelRevision
from service.model.results.part import JsonOf
from service.store.documents import LARGEST_ID, StoredDocument


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
        """Content of `document`. Raises Conflict if it is not done yet (`to_do`: action in the message), BadInput if it
        is invalid.
        """
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
