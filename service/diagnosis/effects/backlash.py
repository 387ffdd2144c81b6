"""A gear with play: while the flanks change, the load coasts and the motor runs free."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, ShapeParameter, named, spread
from service.diagnosis.signals import Tracks

Array = NDArray[np.float64]

CONTACT = 60.0  # Hz, swing of the load on its flank: stiff against the lines
DAMPING = 0.3  # of critical
STEPS = 2  # of the integration to a sample
WEIGHT = 2.0  # times the largest torque of inertia: beyond that, gravity keeps the flank


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    """Torque through the gear with the play less that without it, in sweeps that may change flanks."""
    result = np.zeros_like(tracks.position)
    shaken = np.abs(model.load_inertia * tracks.acceleration).max(axis=1)
    rows = np.flatnonzero(np.abs(tracks.gravity).min(axis=1) < WEIGHT * shaken)
    if rows.size:
        inertia = model.load_inertia[rows, 0]
        result[rows] = through(tracks, rows, inertia, model.viscous, shape[0]) - through(
            tracks, rows, inertia, model.viscous, 0.0
        )
    return [result]


def through(tracks: Tracks, rows: NDArray[np.int_], inertia: Array, viscous: float, play: float) -> Array:
    """Torque (rows, t) that a motor led along the record gives to its load over a dead zone of `play`, rad."""
    position, velocity, gravity = (
        np.ascontiguousarray(signal[rows].T) for signal in (tracks.position, tracks.velocity, tracks.gravity)
    )
    stiffness = inertia * (2 * np.pi * CONTACT) ** 2
    damping = 2 * DAMPING * inertia * 2 * np.pi * CONTACT
    step = 1 / (tracks.rate * STEPS)
    gain, half = step / inertia, play / 2
    twist = gravity[0] / stiffness
    load = position[0] - twist - np.sign(twist) * half
    speed = np.zeros_like(load)
    torque = np.empty_like(position)
    slope = np.diff(position, axis=0, append=position[-1:]) / STEPS
    for n in range(len(torque)):
        for part in range(STEPS):
            lag = position[n] + slope[n] * part - load
            pressed = lag - np.minimum(np.maximum(lag, -half), half)
            force = stiffness * pressed + damping * (pressed != 0.0) * (velocity[n] - speed)
            if part == 0:
                torque[n] = force
            speed = speed + gain * (force - gravity[n] - viscous / 2 * speed)
            load = load + step * speed
    return torque.T


def _shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    return (ShapeParameter("play", "rad", spread(5e-6, 5e-4, 4), 5e-7, 5e-3),)


EFFECT = Effect(
    name="backlash",
    physics="Ts = k dz(q - q_l), dz a dead zone of width b",
    source="Nordin and Gutman, Automatica 38 (2002), Controlling mechanical systems with backlash: a survey",
    sentence="The gear has play: when the torque changes its sign, the motor runs free for a moment.",
    visible_in=("reversal", "forward_slow"),
    entry="spring.backlash",
    coefficients=named(("ratio", "")),
    columns=_columns,
    shape=_shape,
    plausible=(0.5, 2.0),
    rest=0.18,
)
