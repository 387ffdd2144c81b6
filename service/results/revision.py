"""A model revision: what a person accepted of a diagnosis, and `sweepid diagnose --model` writes."""

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
