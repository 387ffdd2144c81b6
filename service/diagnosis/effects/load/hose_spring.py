"""A hose or cable that acts on the axis as a spring with a rest position."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, named
from service.diagnosis.effects.patch import Patch, positive
from service.diagnosis.rows.signals import Tracks

Array = NDArray[np.float64]


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    return [tracks.position**k for k in (1, 0, 2, 3)]


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    stiffness = positive(parameters, "stiffness")
    return {"train": {"hose": {"stiffness": stiffness, "rest": -parameters["torque_at_zero"] / stiffness}}}


EFFECT = Effect(
    name="hose_spring",
    physics="tau = k (q - q0) = k q + c, and a little q^2 and q^3 as it hardens",
    source="Gautier, Janot and Vandanjon, IEEE Trans. Control Syst. Technol. 21 (2013): spring compensators",
    sentence="Something elastic, a hose or a cable, pulls the axis towards a rest position.",
    visible_in=("forward_slow", "backward_slow"),
    entry="hose",
    coefficients=named(
        ("stiffness", "N m/rad"), ("torque_at_zero", "N m"), ("bend", "N m/rad2"), ("hardening", "N m/rad3")
    ),
    contains=("effort_offset",),
    columns=_columns,
    possible=lambda parameters, tracks, model: parameters["stiffness"] > 0,
    scenario=_scenario,
)
