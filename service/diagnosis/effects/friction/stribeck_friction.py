"""Stribeck effect: dry friction that decreases with increasing speed."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, ShapeParameter, named, spread
from service.diagnosis.effects.patch import Patch, dry, positive
from service.diagnosis.rows.signals import Tracks

Array = NDArray[np.float64]


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    speed, bend = shape
    return [tracks.direction, tracks.direction * np.exp(-((np.abs(tracks.velocity) / speed) ** bend))]


def _shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    slow = tracks.speed
    return (
        ShapeParameter("velocity", "rad/s", spread(0.04 * slow, 2.5 * slow, 9), 0.02 * slow, 5 * slow),
        ShapeParameter("exponent", "", (1.0, 2.0), 0.5, 3.0),
    )


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    extra, velocity = positive(parameters, "extra"), parameters["velocity"]
    stribeck = {"extra": extra, "velocity": velocity, "exponent": parameters["exponent"]}
    return dry(parameters["coulomb"], stribeck=stribeck)


EFFECT = Effect(
    name="stribeck_friction",
    physics="tau = (Fc + Fs exp(-|v/vs|^n)) sign(v)",
    source="Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30 (1994), eq. (6)",
    sentence="Friction is larger at the slowest speeds and falls as the axis gets faster.",
    visible_in=("forward_slow", "forward_fast", "backward_fast", "reversal"),
    entry="motor_friction.stribeck",
    coefficients=named(("coulomb", "N m"), ("extra", "N m")),
    contains=("coulomb_friction",),
    columns=_columns,
    scenario=_scenario,
    essential=1,
    possible=lambda parameters, tracks, model: (
        parameters["extra"] > 0 and parameters["coulomb"] > -0.5 * parameters["extra"]
    ),
    shape=_shape,
)
