"""Cogging: torque ripple from the magnets of the motor, periodic in the motor angle."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape
from service.diagnosis.effects.patch import Patch, ripples
from service.diagnosis.rows.signals import Tracks

Array = NDArray[np.float64]


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    axis = tracks.robot.axis(tracks.joint)
    result: list[Array] = []
    for order in _orders(tracks):
        turn = order * axis.gear_ratio
        left = tracks.faded(turn * tracks.velocity)
        result += [left * np.sin(turn * tracks.position), left * np.cos(turn * tracks.position)]
    return result


def _orders(tracks: Tracks) -> list[float]:
    """The orders of the robot file and, for each, order - 1 and order + 1 (modulation by an eccentric rotor)."""
    own = tracks.robot.axis(tracks.joint).cogging_orders
    sides = {order + side for order in own for side in (-1.0, 1.0)}
    return sorted({*own, *(side for side in sides if side > 1)})


def _coefficients(tracks: Tracks) -> Sequence[tuple[str, str]]:
    return [(f"{wave}_{order:g}", "N m") for order in _orders(tracks) for wave in ("sine", "cosine")]


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    return {"train": {"cogging": ripples(parameters, _orders(tracks))}}


EFFECT = Effect(
    name="cogging_torque",
    physics="tau = sum over orders o, o - 1, o + 1 of A sin(o theta) + B cos(o theta), theta the motor's angle",
    source="Hanselman, Brushless Permanent Magnet Motor Design (2006), ch. 9",
    sentence="The motor's torque ripples with its angle.",
    visible_in=("forward_slow", "backward_slow"),
    entry="cogging",
    coefficients=_coefficients,
    columns=_columns,
    scenario=_scenario,
    applies=lambda tracks: bool(tracks.robot.axis(tracks.joint).cogging_orders),
)
