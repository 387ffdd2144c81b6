"""A hose or cable that pulls the axis towards a rest position."""

import numpy as np

from service.diagnosis.effects.effect import Effect, named

EFFECT = Effect(
    name="hose_spring",
    physics="tau = k (q - q0) = k q + c",
    source="Gautier, Janot and Vandanjon, IEEE Trans. Control Syst. Technol. 21 (2013): spring compensators",
    sentence="Something elastic, a hose or a cable, pulls the axis towards a rest position.",
    visible_in=("forward_slow", "standstill"),
    entry="hose",
    coefficients=named(("stiffness", "N m/rad"), ("torque_at_zero", "N m")),
    columns=lambda tracks, model, shape: [tracks.position, np.ones_like(tracks.position)],
)
