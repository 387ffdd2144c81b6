"""Dry friction that changes with the angle of the joint, once per turn."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import CatalogueEffect, Inexpressible, Model, Patch, Shape, named
from service.diagnosis.rows.signals import Tracks


def columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[NDArray[np.float64]]:
    angle = tracks.position
    return [tracks.direction, tracks.direction * np.cos(angle), tracks.direction * np.sin(angle)]


def possible(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> bool:
    """Friction opposes the motion at every angle."""
    return parameters["mean"] >= np.hypot(parameters["cosine"], parameters["sine"])


def scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    raise Inexpressible("the virtual machine's dry friction is the same at every angle")


EFFECT = CatalogueEffect(
    name="seal_drag",
    physics="tau = (F + C cos q + S sin q) sign(v)",
    source="the lip force of a radial shaft seal follows the shaft's runout, one period a turn",
    sentence="Dry friction changes with the joint's angle, once a turn: a seal runs out of round.",
    visible_in=("backward_slow", "reversal"),
    entry="none",
    coefficients=named(("mean", "N m"), ("cosine", "N m"), ("sine", "N m")),
    columns=columns,
    essential=1,
    contains=("coulomb_friction",),
    possible=possible,
    scenario=scenario,
    applies=lambda tracks: not tracks.prismatic,
)
