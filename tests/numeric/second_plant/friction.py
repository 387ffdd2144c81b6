"""Dry friction that sticks: bristles integrated exactly over a step, so that no stiffness makes them unstable.

The bristle is that of Dahl (1968) with a level that depends on speed, as in Canudas de Wit et al. (1995): with y the
share of the level that the bristle carries, dy/dt = v / z (1 - y sgn v), of which

    y(t + h) = s + (y - s) exp(-|v| h / z),  s = sgn v

is the exact solution at constant v. The Iwan (1966) model is a set of sliders behind springs that yield one after the
other. `level` is a torque, N m, positive; what a friction opposes has the sign of the motion.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass
class Now:
    """Where all sweeps are at one step, arrays (m,): taken at the middle of the step, to second order."""

    step: float  # s
    time: float  # s
    position: Array  # of the side that a force acts on
    velocity: Array
    acceleration: Array  # of the step before
    load: Array  # what the gear carries, N m
    drive: Array  # what the motor gives, N m


Level = Callable[[Now], Array]


class Sticking(Protocol):
    """Dry friction on one side of a gear."""

    def opposes(self, now: Now, velocity: Array) -> tuple[Array, Array]:
        """Torque at the end of a step at `velocity`, and its derivative by that velocity, N m and N m s/rad."""
        ...

    def moved(self, now: Now, velocity: Array) -> None:
        """Take the step at the velocity that came of it."""
        ...


@dataclass
class Bristle:
    """One bristle; `reach`: way on which it yields, rad."""

    level: Level
    reach: float
    share: Array  # (m,) of the level that it carries, -1 to 1

    def opposes(self, now: Now, velocity: Array) -> tuple[Array, Array]:
        level = self.level(now)
        side = np.sign(velocity)
        fade = np.exp(np.abs(velocity) * (-now.step / self.reach))
        rest = self.share - side
        towards = np.where(side == 0.0, 1.0, 1.0 - side * self.share)
        return level * (side + rest * fade), level * towards * fade * (now.step / self.reach)

    def moved(self, now: Now, velocity: Array) -> None:
        side = np.sign(velocity)
        self.share = side + (self.share - side) * np.exp(np.abs(velocity) * (-now.step / self.reach))


@dataclass
class Sliders:
    """Sliders behind springs; `reaches` (k, 1), rad, `parts` (k, 1) of the level, which add up to one."""

    level: Level
    reaches: Array
    parts: Array
    shares: Array  # (k, m)
    slopes: Array = field(init=False)

    def __post_init__(self) -> None:
        self.slopes = self.parts / self.reaches

    def opposes(self, now: Now, velocity: Array) -> tuple[Array, Array]:
        level = self.level(now)
        pulled = self.shares + velocity * (now.step / self.reaches)
        holds = np.abs(pulled) < 1.0
        carried = (self.parts * np.clip(pulled, -1.0, 1.0)).sum(axis=0)
        return level * carried, level * now.step * (self.slopes * holds).sum(axis=0)

    def moved(self, now: Now, velocity: Array) -> None:
        self.shares = np.clip(self.shares + velocity * (now.step / self.reaches), -1.0, 1.0)
