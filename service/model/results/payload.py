"""A payload on the last link: `sweepid estimate payload --json`."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pydantic import AliasChoices, ConfigDict, Field

from service.model.results.effect import Number
from service.model.results.part import Column, Document, Part, Shown, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes


DETECTED = 5.0  # standard deviations of a mass: friction that changed between the runs looked like four


class BodyFigure(Part):
    """A value of the body; null if the motions did not excite it. `std_total`: including the torque constants."""

    value: Number | None
    std: Number | None
    std_total: Number | None
    excited: bool


class BodyParameters(Part):
    """The ten parameters at the frame's origin, with covariance for given torque constants, and in total."""

    names: tuple[str, ...]
    values: tuple[Number, ...]
    covariance: tuple[tuple[Number, ...], ...]
    covariance_total: tuple[tuple[Number, ...], ...]


class PayloadBody(Part):
    """kg, m and kg m^2 about the centre of mass, by name."""

    mass: Number
    center: tuple[Number, Number, Number]
    inertia: dict[str, Number]


class PhysicalBody(Part):
    """Whether a body can have these ten values; the nearest possible ones; distance in standard deviations."""

    consistent: bool
    deviation_in_std: Number
    nearest: PayloadBody


class Evidence(Part):
    """The motions of an axis that were used."""

    model_config = ConfigDict(serialize_by_alias=True)

    axis: str
    source: str = Field(validation_alias=AliasChoices("from", "source"), serialization_alias="from")


class Payload(Shown, Document):
    """SI, in the `frame` of the last joint; `center` and `inertia` about it by name. `sentences`: text for the user."""

    link: str
    frame: str
    mass: BodyFigure
    center: dict[str, BodyFigure]
    inertia: dict[str, BodyFigure]
    parameters: BodyParameters
    physical: PhysicalBody
    evidence: tuple[Evidence, ...]
    sentences: tuple[str, ...]

    def table(self) -> Table:
        """Mass, centre of mass and inertia about it."""
        rows = {"mass": self.mass}
        rows |= {f"center {name}": figure for name, figure in self.center.items()}
        rows |= {f"{name} about the center": figure for name, figure in self.inertia.items()}
        std = tuple(one.std for one in rows.values())
        return Table(
            f"Payload on {self.link}, in the frame of {self.frame}, SI",
            (
                Column("", tuple(rows)),
                Column("value", tuple(one.value for one in rows.values()), std=std),
                Column("std", std, std=std),
                Column("std with torque constants", tuple(one.std_total for one in rows.values()), ".2g"),
            ),
        )

    def plot(self) -> "Sequence[Axes]":
        """Draws mass, centre of mass and inertia."""
        from service.model.results import plots  # matplotlib

        return plots.body(self.table())

    def shown(self) -> Sequence[Table | str]:
        """Also what is not known, in words."""
        return (self.table(), *self.sentences)
