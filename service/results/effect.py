"""Effects of an axis, and the axis beside them: in diagnoses and in the models that people accept from them."""

from typing import Annotated, Literal

from pydantic import Field, JsonValue, Strict

from service.results.part import Part

Number = Annotated[float, Strict()]  # neither the text of one nor true


class Value(Part):
    """A number with one standard deviation (null: not known) and its unit."""

    value: Number
    std: Number | None
    unit: str = ""


class Effect(Part):
    """An effect of the catalogue with its parameters.

    `covariance` in the order in which the parameters were written. `scenario`: what it adds to the scenario of a
    virtual machine, null where no scenario holds it.
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
    """The rigid axis beside its effects; `torques`: as the drive recorded them, or true ones."""

    inertia: tuple[PoseInertia, ...]
    gravity: tuple[PoseGravity, ...] | None = None
    viscous_friction: Value
    torques: Literal["recorded", "true"] = "recorded"
