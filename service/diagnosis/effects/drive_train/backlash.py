"""Gear backlash: between the flanks the load coasts and the motor is free; contact is without rebound."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, ShapeParameter, named, spread
from service.diagnosis.effects.patch import Patch
from service.diagnosis.rows.signals import Tracks

Array = NDArray[np.float64]


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    return _scan(tracks, model, [shape])[0]


def _scan(tracks: Tracks, model: Model, shapes: Sequence[Shape]) -> Sequence[Sequence[Array]]:
    """Difference of the motor torque with and without backlash, in sweeps where the contact flank may change."""
    result: Array = np.zeros((len(shapes), *tracks.position.shape))
    shaken = np.abs(model.load_inertia * tracks.acceleration).max(axis=1)
    # 2.0 times the largest inertia torque: with more gravity, the contact flank never changes
    rows = np.flatnonzero(np.abs(model.gravity).min(axis=1) < 2.0 * shaken)
    if rows.size:
        plays, shares = np.array(shapes).T
        result[:, rows] = missing(
            tracks, model.gravity, rows, model.load_inertia[rows, 0], model.viscous * shares, plays
        )
    return [[result[k]] for k in range(len(shapes))]


def missing(
    tracks: Tracks, gravity: Array, rows: NDArray[np.int_], inertia: Array, viscous: Array, plays: Array
) -> Array:
    """Torque difference (plays, rows, t) for backlash `plays` (rad): no load torque between the flanks, and impacts.

    In the frame of the motor: r is the motor angle minus the load angle; r'' = a + (gravity + b v_l) / J while |r|
    is less than half the play. At a flank the load takes the speed of the motor within one time step.
    """
    step, half, damping = 1 / tracks.rate, plays[:, None] / 2, viscous[:, None] / inertia
    # midpoints between samples, because the load moves from one sample to the next
    velocity = _between(tracks.velocity[rows])
    coasting = _between(tracks.acceleration[rows]) + _between(gravity[rows]) / inertia
    ahead = np.sign(gravity[rows, 0]) * half
    rate = np.zeros_like(ahead)
    lost = np.zeros((len(velocity) + 2, *ahead.shape))
    for n in range(len(velocity)):
        taken = step * (coasting[n] + damping * velocity[n])
        free = rate + taken - step * damping * rate
        moved = ahead + step / 2 * (rate + free)
        ahead = np.minimum(np.maximum(moved, -half), half)
        rate = np.where(moved == ahead, free, 0.0)
        lost[n + 1] = free - rate - taken
    return np.moveaxis((lost[1:] + lost[:-1]) / 2 * (inertia / step), 0, -1)


def _between(signal: Array) -> Array:
    """Mean of each two neighbouring samples of (rows, t): (t - 1, rows)."""
    return np.ascontiguousarray((signal[:, 1:] + signal[:, :-1]).T) / 2


def _shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    return (
        ShapeParameter("play", "rad", spread(5e-6, 5e-4, 16), 5e-7, 5e-3, richer=0.05),
        ShapeParameter("load_friction_share", "", (0.5,), 0.0, 1.0),
    )


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    """Contact is soft and well damped: with rebound, measurement errors change the time of the next impact too much.

    The play is a shape parameter of its own, so there is no ratio.
    """
    # Hz, resonance of the load on the contact stiffness in the twin
    load, swing = float(model.load_inertia.mean()), 2 * np.pi * 60.0
    # 0.7 of critical damping
    flanks = {"stiffness": load * swing**2, "damping": 2 * 0.7 * load * swing, "backlash": parameters["play"]}
    on_load = parameters["load_friction_share"] * model.viscous
    friction = {"viscous": -on_load, "backward_viscous": -on_load}
    return {"train": {"spring": flanks, "motor_friction": friction, "load_friction": {"viscous": on_load}}}


EFFECT = Effect(
    name="backlash",
    physics="Ts = 0 while |q - q_l| < b/2, at the flanks q_l follows q: impacts without rebound",
    source="Nordin and Gutman, Automatica 38 (2002), Controlling mechanical systems with backlash: a survey",
    sentence="The gear has play: when the torque changes its sign, the motor runs free for a moment.",
    visible_in=("reversal", "forward_slow"),
    entry="spring.backlash",
    coefficients=named(("ratio", "")),
    columns=_columns,
    scan=_scan,
    scenario=_scenario,
    shape=_shape,
    of_model=True,
    possible=lambda parameters, tracks, model: 0.5 <= parameters["ratio"] <= 2.0,
)
