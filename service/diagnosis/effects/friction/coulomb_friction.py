"""Dry (Coulomb) friction: a constant torque against the motion."""

from service.diagnosis.effects.effect import Effect, named
from service.diagnosis.effects.patch import dry

EFFECT = Effect(
    name="coulomb_friction",
    physics="tau = Fc sign(v)",
    source="Coulomb 1785; Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30 (1994), sec. 2",
    sentence="Dry friction of the same size at every speed opposes the motion.",
    visible_in=("backward_slow", "reversal"),
    entry="motor_friction.coulomb",
    coefficients=named(("coulomb", "N m")),
    columns=lambda tracks, model, shape: [tracks.direction],
    scenario=lambda parameters, tracks, model: dry(parameters["coulomb"]),
    possible=lambda parameters, tracks, model: parameters["coulomb"] > 0,
)
