"""A constant torque: zero-point error of the current measurement."""

import numpy as np

from service.diagnosis.effects.effect import Effect, named

EFFECT = Effect(
    name="effort_offset",
    physics="tau = c",
    source="Gautier and Briot, J. Dyn. Sys. Meas. Control 136 (2014), offset of the current sensor",
    sentence="The drive tells a constant torque too much, in either direction.",
    visible_in=("forward_slow", "backward_slow"),
    entry="effort_offset",
    coefficients=named(("offset", "N m")),
    columns=lambda tracks, model, shape: [np.ones_like(tracks.velocity)],
    scenario=lambda parameters, tracks, model: {"train": {"effort_offset": parameters["offset"]}},
)
