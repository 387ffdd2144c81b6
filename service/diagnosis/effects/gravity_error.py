"""Gravity torque of links whose mass or centre of mass is not that of CAD."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape
from service.diagnosis.links import deviations
from service.diagnosis.patch import Patch
from service.diagnosis.signals import Tracks
from service.identification.regressor import gravity_terms

Array = NDArray[np.float64]

TELLING = 0.02  # of the largest singular value: smaller directions hardly change the torque


def gravity_columns(tracks: Tracks, parameters: Array) -> Array:
    """Torque (n, t) of links (11 n or 10 n) along the motion."""
    index = tracks.robot.index(tracks.joint)
    terms = gravity_terms(tracks.robot.chain, parameters, tracks.robot.gravity, index, tracks.poses)[tracks.spot]
    away = tracks.position - tracks.poses[tracks.spot, index][:, None]
    return terms[:, :1] * np.cos(away) + terms[:, 1:] * np.sin(away)


def _directions(tracks: Tracks) -> Array:
    """Changes of the links' parameters (k, 10 links) that move the gravity torque, of typical size, largest first."""
    robot, index = tracks.robot, tracks.robot.index(tracks.joint)
    nominal = robot.chain.inertial
    changes: list[Array] = []
    for link in range(index, len(nominal)):
        for moment in range(1, 4):
            change = np.zeros_like(nominal)
            change[link, moment] = robot.prior.gravity * max(float(np.linalg.norm(nominal[link, 1:4])), 1e-9)
            changes.append(change.ravel())
        change = np.zeros_like(nominal)
        change[link, 0] = robot.prior.gravity * nominal[link, 0]
        changes.append(change.ravel())
    matrix = np.array(changes)
    terms = np.stack([gravity_terms(robot.chain, row, robot.gravity, index, tracks.poses).ravel() for row in matrix])
    u, s, _ = np.linalg.svd(terms, full_matrices=False)
    if s[0] <= 1e-9 * robot.axis(tracks.joint).rated_effort:
        return np.empty((0, nominal.size))
    return u.T[s > TELLING * s[0]] @ matrix


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    return [gravity_columns(tracks, direction) for direction in _directions(tracks)]


def _coefficients(tracks: Tracks) -> Sequence[tuple[str, str]]:
    return [(f"moment_{k + 1}", "") for k in range(len(_directions(tracks)))]


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    changes = sum(value * row for value, row in zip(parameters.values(), _directions(tracks), strict=True))
    return {"links": deviations(tracks.robot, np.reshape(changes, tracks.robot.chain.inertial.shape)[:, :4])}


EFFECT = Effect(
    name="gravity_error",
    physics="tau = A cos q + B sin q for each group of links: their first moments differ from CAD",
    source="Atkeson, An and Hollerbach, Int. J. Robotics Research 5 (1986): torque linear in first moments",
    sentence="Gravity pulls otherwise than CAD says: masses or centres of mass are wrong.",
    visible_in=("forward_slow", "backward_slow"),
    entry="links",
    coefficients=_coefficients,
    contains=("payload", "torque_constant_error"),
    columns=_columns,
    scenario=_scenario,
    applies=lambda tracks: len(_directions(tracks)) > 0,
)
