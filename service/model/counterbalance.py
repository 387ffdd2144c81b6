r"""The counterbalance of an axis: a spring or a gas cylinder between a point of the parent link and one that turns.

With c and a the arms of the two points across the axis and d their distance along it, the length at the angle q is

    l^2 = d^2 + c^2 + a^2 - 2 c a cos(q - zero)

and by virtual work the drive must provide  F(l) dl/dq,  F pulling the points together:

    F(l) = force (1 - (l - length) / column)^-exponent + rate (l - length)

A spring has a `rate` alone. In a cylinder a `column` of gas is compressed (polytropic): as it lengthens, or with a
negative column as it shortens. A strut that pushes has a negative `force`.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from service import BadInput
from service.model.arrays import Array
from service.model.physical_bounds import Most
from service.model.urdf import Joint

SHORTEST = 1e-3  # m, between the two points
COMPRESSED = 0.05  # of the gas column, at most

Length = Annotated[float, Field(ge=-Most.length, le=Most.length)]
Point = tuple[Length, Length, Length]


@dataclass(frozen=True)
class Lever:
    """Length l of a counterbalance over the angle q: ``l^2 = mean - swing cos(q - zero)``; m^2, rad."""

    mean: float
    swing: float
    zero: float

    def length(self, position: Array) -> Array:
        """m, of the same shape."""
        return np.sqrt(self.mean - self.swing * np.cos(position - self.zero))

    def arm(self, position: Array) -> Array:
        """dl/dq, m/rad."""
        return self.swing * np.sin(position - self.zero) / (2 * self.length(position))


def positions(joint: Joint) -> Array:
    """Over the range of a revolute joint, rad, a turn if it has no limits."""
    ends = (joint.lower, joint.upper) if np.isfinite([joint.lower, joint.upper]).all() else (-np.pi, np.pi)
    return np.linspace(*ends, 361)


class Counterbalance(BaseModel):
    """Between `anchor`, m in the frame of the previous joint's link (the base for the first joint), and `attachment`, m
    in the frame of the joint's own link. `force`, N, is the pull at `length`, m.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    anchor: Point
    attachment: Point
    force: float = Field(ge=-Most.effort, le=Most.effort)
    length: float = Field(ge=SHORTEST, le=Most.length)
    rate: float = Field(default=0.0, ge=0, le=Most.effort)  # N/m
    column: Length | None = None  # m of gas at `length`
    exponent: float = Field(default=1.0, ge=1, le=2)  # 1: isothermal; 1.4: too fast for nitrogen to exchange heat

    @model_validator(mode="after")
    def _is_something(self) -> "Counterbalance":
        if self.column == 0:
            raise ValueError("column must not be 0: there would be no gas")
        if not self.force and not self.rate:
            raise ValueError("force and rate are both 0: it would carry nothing")
        return self

    def lever(self, joint: Joint) -> Lever:
        """How it acts on its joint."""
        axis, fixed = joint.axis, joint.rotation.T @ (np.array(self.anchor) - joint.translation)
        turned = np.array(self.attachment)
        apart = float((fixed - turned) @ axis)
        fixed, turned = fixed - (fixed @ axis) * axis, turned - (turned @ axis) * axis
        zero = float(np.arctan2(np.cross(turned, fixed) @ axis, turned @ fixed))
        arms = np.linalg.norm(fixed), np.linalg.norm(turned)
        return Lever(apart**2 + float(arms[0] ** 2 + arms[1] ** 2), float(2 * arms[0] * arms[1]), zero)

    def pull(self, length: Array) -> Array:
        """F, N, at lengths in m."""
        longer = length - self.length
        gas = 1.0 if self.column is None else (1 - longer / self.column) ** -self.exponent
        return self.force * gas + self.rate * longer

    def effort(self, lever: Lever, position: Array) -> Array:
        """What the drive must provide, N m, at positions in rad."""
        return self.pull(lever.length(position)) * lever.arm(position)

    def off(self, share: float, rate: float) -> "Counterbalance":
        """One whose force is larger by a share of itself, and its rate by N/m more."""
        own = {"force": (1 + share) * self.force, "rate": (1 + share) * self.rate + rate}
        return self.model_copy(update=own)

    def entry(self, lever: Lever) -> dict[str, float]:
        """As an entry of a scenario (docs/reference/scenario.md); crank and arm are no longer told apart."""
        half = np.sqrt(lever.mean + np.array([1.0, -1.0]) * lever.swing) / 2
        told = {"crank": float(half[0] - half[1]), "arm": float(half[0] + half[1]), "zero": lever.zero}
        return told | self.model_dump(include={"force", "length", "rate", "column", "exponent"}, exclude_none=True)

    def check(self, joint: Joint, place: str) -> None:
        """BadInput if it has no lever on its joint, or cannot reach all its positions."""
        if joint.kind == "prismatic":
            raise BadInput(place, "is on a linear axis; a counterbalance turns about a revolute joint")
        lever = self.lever(joint)
        if lever.swing < SHORTEST**2:
            raise BadInput(place, "has no lever: one of its points is on the axis")
        lengths = lever.length(positions(joint))
        if lengths.min() < SHORTEST:
            raise BadInput(place, "has both points at the same place at a position of the joint")
        if self.column is not None and (1 - (lengths - self.length) / self.column).min() < COMPRESSED:
            raise BadInput(
                place,
                f"column of {self.column:g} m is used up: the length goes from {lengths.min():.4g} "
                f"to {lengths.max():.4g} m over the joint's range",
            )
