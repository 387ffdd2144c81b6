"""Temperature of a gear at the start of a sweep, from the earlier sweeps in the order in which they were run."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.effects.friction import FrictionLaw
from simulator.scenario import DriveTrain

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Turn:
    """One motion of an axis: start, s since the campaign start, sample interval, s, and speed (n,), rad/s."""

    started_at: float
    interval: float
    velocity: Array


def warmth(train: DriveTrain, turns: Sequence[Turn]) -> Array:
    """Temperature rise (m,) K at the start of each turn, from a cold start. Overlapping turns are put one after the
    other.

    The power of a turn is its mean at the temperature of its start, without load-dependent friction.
    """
    rises, warming = np.zeros(len(turns)), train.warming
    if warming is None:
        return rises
    rise = time = 0.0
    for number in sorted(range(len(turns)), key=lambda k: (turns[k].started_at, k)):
        turn = turns[number]
        rise *= np.exp(-max(turn.started_at - time, 0.0) / warming.time_constant)
        rises[number] = rise
        velocity, nothing = turn.velocity[None], np.zeros(1)
        power = float(np.mean(FrictionLaw([train], [rise], 0.0).power(velocity, nothing, nothing)))
        duration = len(turn.velocity) * turn.interval
        limit = power * warming.time_constant / warming.heat_capacity
        rise = limit + (rise - limit) * np.exp(-duration / warming.time_constant)
        time = max(turn.started_at, time) + duration
    return rises
