"""Presliding: after a reversal, friction builds up like a spring over a short distance."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, ShapeParameter, named, spread
from service.diagnosis.effects.patch import Inexpressible, Patch
from service.diagnosis.rows.signals import Tracks, bristles

Array = NDArray[np.float64]

SPREAD = (0.25, 0.5, 2.0, 4.0)  # times the distance: bristles of different stiffness, as in the Iwan model


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    state, *spread = bristles(tracks.position, [shape[0] * factor for factor in (1.0, *SPREAD)])
    return [state, np.gradient(state, axis=1) * tracks.rate * shape[0], *spread]


def _shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    way = tracks.speed / (2 * np.pi)
    # 1.0 times the distance within which sticking friction reverses: shorter is no presliding
    least = max(2e-3 * way, 1.0 * tracks.turning)
    return (ShapeParameter("way", "rad", spread(least, max(way, 3 * least), 8), least, max(3 * way, 9 * least)),)


def _level(parameters: Mapping[str, float]) -> float:
    """Friction level of all bristles together, N m."""
    return sum(parameters[name] for name in parameters if name.startswith("coulomb"))


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    """LuGre bristles that break away at the Coulomb friction are equal to those of Dahl."""
    coulomb = _level(parameters)
    if coulomb <= 0:
        raise Inexpressible(f"dry friction = {coulomb:.3g} is not above 0")
    bristles = {"stiffness": coulomb / parameters["way"], "damping": parameters["damping"], "coulomb": coulomb}
    return {"train": {"lugre": bristles | {"breakaway": coulomb, "stribeck_velocity": tracks.speed}}}


EFFECT = Effect(
    name="presliding_hysteresis",
    physics="tau = Fc z + s dz/dt, dz/dx = (1 - z sign(v)) / x0; some bristles at a quarter and at four times the way",
    source="Dahl 1968; Canudas de Wit, Olsson, Astrom and Lischinsky, IEEE Trans. Automatic Control 40 (1995)",
    sentence="Friction first gives like a spring: after each reversal it builds up over a short way.",
    visible_in=("reversal",),
    entry="lugre",
    coefficients=named(
        ("coulomb", "N m"), ("damping", "N m s/rad"), *((f"coulomb_{factor:g}", "N m") for factor in SPREAD)
    ),
    contains=("coulomb_friction",),
    columns=_columns,
    scenario=_scenario,
    shape=_shape,
    possible=lambda parameters, tracks, model: _level(parameters) > 0,
)
