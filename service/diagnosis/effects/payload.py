"""A mass at the tip that the model does not know."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, ShapeParameter, named
from service.diagnosis.effects.gravity_error import gravity_columns
from service.diagnosis.patch import Patch, positive
from service.diagnosis.signals import Tracks

Array = NDArray[np.float64]

FARTHEST = 1.5  # m from the last axis' origin towards the last link's centre of mass

LENGTH = 0.1  # m of the bar that stands for it


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    links = np.zeros_like(tracks.robot.chain.inertial)
    links[-1, 0] = 1.0
    links[-1, 1:4] = _centre(tracks, shape[0])
    return [gravity_columns(tracks, links.ravel())]


def _centre(tracks: Tracks, distance: float) -> Array:
    """Of the mass, (3,) m in the last link's frame."""
    moment = tracks.robot.chain.inertial[-1, 1:4]
    length = float(np.linalg.norm(moment))
    return distance * moment / length if length > 0 else np.zeros(3)


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    centre, half = _centre(tracks, parameters["distance"]), np.array([LENGTH / 2, 0.0, 0.0])
    ends = {"start": (centre - half).tolist(), "end": (centre + half).tolist()}
    body = {"name": "payload", "mass": positive(parameters, "mass"), "radius": LENGTH / 2}
    return {"links": {tracks.robot.chain.joints[-1].link: {"added": [body | ends]}}}


def _pulls(tracks: Tracks) -> bool:
    return float(np.abs(_columns(tracks, Model(np.ones(1), 0.0, 0.0), (0.0,))[0]).max()) > 1e-6


EFFECT = Effect(
    name="payload",
    physics="tau = m g r(q), m at the last link",
    source="Khalil, Gautier and Lemoine, ICRA 2007, Identification of the payload inertial parameters",
    sentence="The robot carries a mass that the model does not know.",
    visible_in=("forward_slow", "backward_slow"),
    entry="links.added",
    coefficients=named(("mass", "kg")),
    columns=_columns,
    scenario=_scenario,
    shape=lambda tracks, model: (ShapeParameter("distance", "m", (0.0, 0.2, 0.5, 0.9), 0.0, FARTHEST),),
    plausible=(0.0, np.inf),
    by_test_mass=True,
    applies=_pulls,
)
