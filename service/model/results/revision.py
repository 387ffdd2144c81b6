"""A model revision: accepted by a user from a diagnosis, or written by `sweepid diagnose --model`."""

from typing import Literal

from pydantic import JsonValue

from service.model.results.effect import AxisFit, Effect
from service.model.results.part import Document, Part


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


class KnownAxis(Part):
    """Known effects of an axis."""

    effects: tuple[Effect, ...] = ()
    fit: Torques = Torques()


class KnownModel(Document):
    """The part of a model revision, or of a user's file with effects, that an estimate needs."""

    axes: dict[str, KnownAxis]


class StoredModel(Part):
    """A model revision in the store."""

    id: int
    revision: int


class ModelFile(Part):
    """A file with known effects, by its name."""

    file: str


ModelSource = StoredModel | ModelFile
