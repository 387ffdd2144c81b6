"""A second body on the load, with a spring of its own: the resonance of a part that is not rigidly mounted."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.scenario import Appendage

Array = NDArray[np.float64]


class Appendages:
    """``Ja va' = k (ql - qa) + d (vl - va)`` for the rows that have one; the torque acts on the load."""

    def __init__(self, rows: Sequence[Appendage | None], step: float) -> None:
        self._step = step
        self._inertia = np.array([r.inertia if r else 1.0 for r in rows])
        self._stiffness = np.array([r.stiffness if r else 0.0 for r in rows])
        self._damping = np.array([r.damping if r else 0.0 for r in rows])
        self.position = np.zeros(len(rows))
        self._velocity = np.zeros(len(rows))

    def settle(self, row: int, load_position: float) -> None:
        """At rest with the load."""
        self.position[row], self._velocity[row] = load_position, 0.0

    def step(self, load_position: Array, load_velocity: Array) -> Array:
        """Torque (rows,) N m from the load to the bodies."""
        torque = self._stiffness * (load_position - self.position) + self._damping * (load_velocity - self._velocity)
        self._velocity += self._step / self._inertia * torque
        self.position += self._step * self._velocity
        return torque
