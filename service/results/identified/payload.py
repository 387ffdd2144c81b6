"""A payload on the last link: `sweepid payload --json`."""

from pydantic import AliasChoices, ConfigDict, Field

from service.results.effect import Number
from service.results.part import Document, Part


class Figure(Part):
    """A number of the body; null is what the motions did not excite. `std_total`: with the torque constants."""

    value: Number | None
    std: Number | None
    std_total: Number | None
    excited: bool


class Parameters(Part):
    """The ten at the frame's origin, with their covariance given the torque constants, and in all."""

    names: tuple[str, ...]
    values: tuple[Number, ...]
    covariance: tuple[tuple[Number, ...], ...]
    covariance_total: tuple[tuple[Number, ...], ...]


class Body(Part):
    """kg, m and kg m^2 about the centre of mass, by name."""

    mass: Number
    center: tuple[Number, Number, Number]
    inertia: dict[str, Number]


class Physical(Part):
    """Whether a body can have these ten numbers; the nearest that can, and how many standard deviations away."""

    consistent: bool
    deviation_in_std: Number
    nearest: Body


class Evidence(Part):
    """From which motions of an axis it was found."""

    model_config = ConfigDict(serialize_by_alias=True)

    axis: str
    source: str = Field(validation_alias=AliasChoices("from", "source"), serialization_alias="from")


class Payload(Document):
    """SI, in the `frame` of the last joint; `center` and `inertia` about it by name. `sentences` for people."""

    link: str
    frame: str
    mass: Figure
    center: dict[str, Figure]
    inertia: dict[str, Figure]
    parameters: Parameters
    physical: Physical
    evidence: tuple[Evidence, ...]
    sentences: tuple[str, ...]
