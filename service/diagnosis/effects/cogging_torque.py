"""Torque ripple of the motor's magnets: periodic in the motor's angle."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape
from service.diagnosis.patch import Patch, ripples
from service.diagnosis.signals import Tracks

Array = NDArray[np.float64]


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    axis = tracks.robot.axis(tracks.joint)
    result: list[Array] = []
    for order in axis.cogging_orders:
        turn = order * axis.gear_ratio
        left = tracks.faded(turn * tracks.velocity)
        result += [left * np.sin(turn * tracks.position), left * np.cos(turn * tracks.position)]
    return result


def _coefficients(tracks: Tracks) -> Sequence[tuple[str, str]]:
    orders = tracks.robot.axis(tracks.joint).cogging_orders
    return [(f"{wave}_{order:g}", "N m") for order in orders for wave in ("sine", "cosine")]


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    return {"train": {"cogging": ripples(parameters, tracks.robot.axis(tracks.joint).cogging_orders)}}


EFFECT = Effect(
    name="cogging_torque",
    physics="tau = sum over orders o of A sin(o theta) + B cos(o theta), theta the motor's angle",
    source="Hanselman, Brushless Permanent Magnet Motor Design (2006), ch. 9",
    sentence="The motor's torque ripples with its angle.",
    visible_in=("forward_slow", "backward_slow"),
    entry="cogging",
    coefficients=_coefficients,
    columns=_columns,
    scenario=_scenario,
    applies=lambda tracks: bool(tracks.robot.axis(tracks.joint).cogging_orders),
)
