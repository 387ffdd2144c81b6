"""Effects of an axis, and its rigid model: in diagnoses and in the models that users accept from them."""

import math
from typing import Annotated, Literal

from pydantic import Field, JsonValue, Strict

from service.model.results.part import Document, Part

Number = Annotated[float, Strict()]  # no strings or booleans


class Value(Part):
    """A number with one standard deviation (null: not known) and its unit."""

    value: Number
    std: Number | None
    unit: str = ""

    @property
    def significant(self) -> bool:
        """Whether the sweeps tell it apart from 0 by at least two standard deviations."""
        return self.std is None or self.std <= abs(self.value) / 2

    @property
    def words(self) -> str:
        """Value, standard deviation and unit."""
        std = math.nan if self.std is None else self.std
        return f"{self.value:.4g} ± {std:.2g} {self.unit.replace('^2', '²')}".rstrip()


class Effect(Part):
    """An effect of the catalogue with its parameters.

    `covariance` in the order in which the parameters were written. `scenario`: its part of the scenario of a
    virtual machine, null if no scenario can contain it.
    """

    effect: str
    sentence: str = ""
    physics: str = ""
    source: str = ""
    parameters: dict[str, Value]
    covariance: tuple[tuple[Number, ...], ...] = ()
    evidence: dict[str, float | None] = Field(default={})
    scenario_entry: str | None = None
    scenario: dict[str, JsonValue] | None = None


class PoseInertia(Part):
    """Inertia in a pose, kg m^2 (kg)."""

    pose: tuple[float, ...]
    value: float
    std: float | None


class PoseGravity(Part):
    """Gravity in a pose, N m (N), and its slope over the axis' own position."""

    pose: tuple[float, ...]
    torque: float
    slope: float


class AxisFit(Part):
    """The rigid model of an axis with effects; `torques`: as recorded by the drive, or true ones."""

    inertia: tuple[PoseInertia, ...]
    gravity: tuple[PoseGravity, ...] | None = None
    viscous_friction: Value
    torques: Literal["recorded", "true"] = "recorded"


class RevisedAxis(Part):
    """Known effects of an axis, and its rigid model."""

    effects: tuple[Effect, ...]
    fit: AxisFit


class ModelRevision(Document):
    """By joint; the corresponding scenario of a virtual machine, and the parts that a scenario cannot contain."""

    axes: dict[str, RevisedAxis]
    scenario: dict[str, JsonValue]
    notes: tuple[str, ...]


class Torques(Part):
    """Of the rigid axis: whether its torques are as recorded by the drive."""

    torques: Literal["recorded", "true"] = "recorded"


class KnownEffectsOfAxis(Part):
    """Known effects of an axis."""

    effects: tuple[Effect, ...] = ()
    fit: Torques = Torques()


class KnownModel(Document):
    """The part of a model revision, or of a user's file with effects, that an estimate needs."""

    axes: dict[str, KnownEffectsOfAxis]


class StoredModel(Part):
    """A model revision in the store."""

    id: int
    revision: int


class ModelFile(Part):
    """A file with known effects, by its name."""

    file: str


ModelSource = StoredModel | ModelFile
