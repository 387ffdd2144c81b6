"""A model revision: what a person accepted of a diagnosis, and `sweepid diagnose --model` writes."""

from typing import Literal

from pydantic import JsonValue

from service.results.effect import AxisFit, Effect
from service.results.part import Document, Part


class RevisedAxis(Part):
    """What an axis is known to have, and the rigid axis beside it."""

    effects: tuple[Effect, ...]
    fit: AxisFit


class ModelRevision(Document):
    """By joint; the scenario of a virtual machine that is like it, and what a scenario cannot hold."""

    axes: dict[str, RevisedAxis]
    scenario: dict[str, JsonValue]
    notes: tuple[str, ...]


class Torques(Part):
    """Of the rigid axis: whether its torques are as the drive recorded them."""

    torques: Literal["recorded", "true"] = "recorded"


class KnownAxis(Part):
    """What an axis is known to have."""

    effects: tuple[Effect, ...] = ()
    fit: Torques = Torques()


class KnownModel(Document):
    """What an estimate needs of a model revision, or of a file with effects that somebody wrote."""

    axes: dict[str, KnownAxis]


class StoredModel(Part):
    """A model revision of the store."""

    id: int
    revision: int


class ModelFile(Part):
    """A file with known effects, by its name."""

    file: str


ModelSource = StoredModel | ModelFile
