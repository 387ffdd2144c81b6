"""Laws of the literature as forces on an axis: torques that the drive must overcome, (m,) one a sweep."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.numeric.second_plant.bodies import Curve
from tests.numeric.second_plant.friction import Now

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Law:
    """Any law of where all sweeps are."""

    torque: Callable[[Now], Array]


@dataclass(frozen=True)
class Hose:
    """A hose package: a hardening spring with damping; k x (1 + (x / hard)^2) + d v, x from its rest."""

    stiffness: float
    rest: float
    hard: float
    damping: float

    def torque(self, now: Now) -> Array:
        away = now.position - self.rest
        return self.stiffness * away * (1.0 + np.square(away / self.hard)) + self.damping * now.velocity


@dataclass(frozen=True)
class Waves:
    """A sum of sines of the motor's turn, each growing with the load: a (1 + w |load| / rated) sin(o u q + phase)."""

    ratio: float
    orders: Array  # (k, 1) periods per motor revolution
    amplitudes: Array  # (k, 1) N m
    phases: Array  # (k, 1)
    with_load: float = 0.0
    rated: float = 1.0

    def torque(self, now: Now) -> Array:
        waves = (self.amplitudes * np.sin(self.orders * (self.ratio * now.position) + self.phases)).sum(axis=0)
        return waves * (1.0 + self.with_load * np.abs(now.load) / self.rated) if self.with_load else waves


@dataclass(frozen=True)
class Wobble:
    """A gear whose ratio wobbles: load position = q + sum e sin(o u q + phase), from virtual work (load inertia J).

    tau = (1 + e') (J dv_l/dt + weight) with v_l = (1 + e') v; a rigid gear is that with e' = 0, which is left out.
    """

    ratio: float
    orders: Array  # (k, 1)
    errors: Array  # (k, 1) rad at the joint
    phases: Array  # (k, 1)
    inertia: Array  # (m,)
    weight: Curve

    def torque(self, now: Now) -> Array:
        wave = self.orders * self.ratio
        turn = wave * now.position + self.phases
        sine = self.errors * np.sin(turn)
        error, slope = sine.sum(axis=0), (self.errors * wave * np.cos(turn)).sum(axis=0)
        bend = -(wave**2 * sine).sum(axis=0)
        load_acceleration = (1.0 + slope) * now.acceleration + bend * np.square(now.velocity)
        there = self.weight.at(now.position + error)
        whole = (1.0 + slope) * (self.inertia * load_acceleration + there)
        return whole - self.inertia * now.acceleration - self.weight.at(now.position)
