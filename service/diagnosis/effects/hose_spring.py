"""A hose or cable that pulls the axis towards a rest position."""

from collections.abc import Mapping

import numpy as np

from service.diagnosis.effects.effect import Effect, Model, named
from service.diagnosis.patch import Patch, positive
from service.diagnosis.signals import Tracks


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    stiffness = positive(parameters, "stiffness")
    return {"train": {"hose": {"stiffness": stiffness, "rest": -parameters["torque_at_zero"] / stiffness}}}


EFFECT = Effect(
    name="hose_spring",
    physics="tau = k (q - q0) = k q + c",
    source="Gautier, Janot and Vandanjon, IEEE Trans. Control Syst. Technol. 21 (2013): spring compensators",
    sentence="Something elastic, a hose or a cable, pulls the axis towards a rest position.",
    visible_in=("forward_slow", "backward_slow"),
    entry="hose",
    coefficients=named(("stiffness", "N m/rad"), ("torque_at_zero", "N m")),
    contains=("effort_offset",),
    columns=lambda tracks, model, shape: [tracks.position, np.ones_like(tracks.position)],
    scenario=_scenario,
)
