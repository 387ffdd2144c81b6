"""A diagnosis: where model and measurement disagree, axis by axis, and the model that comes of it."""

from typing import Literal

from pydantic import Field, JsonValue

from service.results.cell import Cell
from service.results.check import Finding
from service.results.effect import AxisFit, Effect, Value
from service.results.experiment import Experiment
from service.results.part import Document, Part

Verdict = Literal["none", "named", "ambiguous", "unknown", "untestable"]


class Change(Part):
    """A parameter of an effect that the model had: what the model says, and what is so now."""

    effect: str
    parameter: str
    model: Value
    now: Value


class Rival(Part):
    """Another candidate in place of the chosen explanation, and by how much of Schwarz's criterion it is `behind`."""

    effect: str
    behind: float


class PoseGap(Part):
    """RMS of what is left in one pose, N m (N); the noise floor is null where nothing was repeated."""

    pose: tuple[float, ...]
    before_rms: float
    after_rms: float
    noise_floor_rms: float | None
    sweeps: int


class Gap(Part):
    """RMS of what is left, N m (N), and in percent of the effort.

    `held_out_sweeps`: those that took no part in naming or fit. `cross_validated`: each pose (or repeat) was judged by
    the others; documents of before the key was there were so whenever they could be. `twin_rms`: what the simulator
    leaves with the model found.
    """

    before_rms: float
    after_rms: float
    noise_floor_rms: float | None
    held_out_sweeps: int
    cross_validated: bool = False
    source: str = "columns"
    before_percent: float
    after_percent: float
    twin_rms: float | None = None
    by_pose: tuple[PoseGap, ...]


class Example(Part):
    """The sweep with the largest gap: time, s; effort measured and as either model needs it, N m (N)."""

    sweep: str
    block: str
    time: tuple[float, ...]
    measured: tuple[float, ...]
    before: tuple[float, ...]
    after: tuple[float, ...]


class RigidParameter(Part):
    """A base parameter of the rigid model: what CAD or an estimate says (null: nothing), and what was found."""

    name: str
    nominal: float | None
    value: float
    std: float | None


class AxisDiagnosis(Document):
    """What was found of one axis; `unit` is that of its effort.

    `effects` are named (or, undecided, the simplest explanation so far), `known` those of the model, `part` those that
    explain a part beside an unknown rest. `where` is the map of the gap, `data` what the check of the data found.
    """

    verdict: Verdict
    unit: str
    effects: tuple[Effect, ...]
    known: tuple[Effect, ...]
    part: tuple[Effect, ...] = ()
    changes: tuple[Change, ...] = ()
    candidates: tuple[str, ...]
    alternatives: tuple[tuple[str, ...], ...] = ()
    rivals: tuple[Rival, ...]
    rolled_back: tuple[str, ...]
    where: tuple[Cell, ...]
    sentences: tuple[str, ...]
    gap: Gap
    example: Example
    fit: AxisFit
    started_from: str = "cad"
    rigid_model: tuple[RigidParameter, ...] = ()
    unexplained: float | None = None
    next_experiment: Experiment | None
    untestable: tuple[str, ...]
    data: tuple[Finding, ...] = ()
    visible_in: dict[str, tuple[str, ...]] = Field(default={})
    summary: str

    @property
    def explained(self) -> bool:
        """Whether there is an after: effects that the model had not."""
        return bool(self.effects)


class DiagnosedModel(Part):
    """The model that the axes make: effects by joint, the scenario of a virtual machine, and what that cannot hold."""

    robot: str
    effects: dict[str, tuple[Effect, ...]]
    scenario: dict[str, JsonValue] = Field(default={})
    notes: tuple[str, ...] = ()


class Diagnosis(Document):
    """All axes by joint, and the model that the named effects make: `sweepid diagnose --json`."""

    axes: dict[str, AxisDiagnosis]
    model: DiagnosedModel
