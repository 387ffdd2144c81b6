"""Friction that first gives like a spring: after a reversal it builds up over a short way."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, ShapeParameter, named, spread
from service.diagnosis.patch import Patch, positive
from service.diagnosis.signals import Tracks

Array = NDArray[np.float64]


def bristle(tracks: Tracks, way: float) -> Array:
    """Dahl's state (n, t) between -1 and 1: dz/dx = (1 - z sign(v)) / way, exact for each step of the position."""
    steps = np.diff(tracks.position, axis=1, prepend=tracks.position[:, :1])
    keep, sign = np.exp(-np.abs(steps) / way), np.sign(steps)
    state = np.zeros_like(steps)
    now = np.zeros(len(steps))
    for n in range(1, steps.shape[1]):
        now = sign[:, n] + (now - sign[:, n]) * keep[:, n]
        state[:, n] = now
    return state


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    state = bristle(tracks, shape[0])
    return [state, np.gradient(state, axis=1) * tracks.rate * shape[0]]


def _shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    way = tracks.speed / (2 * np.pi)
    return (ShapeParameter("way", "rad", spread(2e-3 * way, way, 8), 1e-3 * way, 3 * way),)


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    """LuGre's bristles, which break away at the Coulomb friction, are Dahl's."""
    coulomb = positive(parameters, "coulomb")
    bristles = {"stiffness": coulomb / parameters["way"], "damping": parameters["damping"], "coulomb": coulomb}
    return {"train": {"lugre": bristles | {"breakaway": coulomb, "stribeck_velocity": tracks.speed}}}


EFFECT = Effect(
    name="presliding_hysteresis",
    physics="tau = Fc z + s dz/dt, dz/dx = (1 - z sign(v)) / x0",
    source="Dahl 1968; Canudas de Wit, Olsson, Astrom and Lischinsky, IEEE Trans. Automatic Control 40 (1995)",
    sentence="Friction first gives like a spring: after each reversal it builds up over a short way.",
    visible_in=("reversal",),
    entry="lugre",
    coefficients=named(("coulomb", "N m"), ("damping", "N m s/rad")),
    contains=("coulomb_friction",),
    columns=_columns,
    scenario=_scenario,
    shape=_shape,
    plausible=(0.0, np.inf),
)
