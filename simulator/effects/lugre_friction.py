"""Presliding friction of the LuGre model (Canudas de Wit et al. 1995)."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.scenario import LuGre

Array = NDArray[np.float64]


class Bristles:
    """LuGre friction of the rows that have it; zero for the others. z is stepped implicitly: stable at any speed."""

    def __init__(self, rows: Sequence[LuGre | None], step: float) -> None:
        self._step = step
        self._stiffness = np.array([r.stiffness if r else 0.0 for r in rows])
        self._damping = np.array([r.damping if r else 0.0 for r in rows])
        self._coulomb = np.array([r.coulomb if r else 1.0 for r in rows])
        self._extra = np.array([r.breakaway - r.coulomb if r else 0.0 for r in rows])
        self._stribeck = np.array([r.stribeck_velocity if r else 1.0 for r in rows])
        self.deflection = np.zeros(len(rows))

    def step(self, velocity: Array) -> Array:
        """Friction torque (rows,), N m."""
        before = self.deflection
        self.deflection = (before + self._step * velocity) * self._kept(velocity)
        return self._torque(self.deflection, before)

    def along(self, velocity: Array) -> Array:
        """As `step`, for steps (steps, rows) that are known in advance."""
        kept, gained, path = self._kept(velocity), self._step * velocity, np.empty_like(velocity)
        now = before = self.deflection
        for n, (share, more) in enumerate(zip(kept, gained, strict=True)):
            path[n] = now = (now + more) * share
        self.deflection = now
        return self._torque(path, np.concatenate([before[None], path[:-1]]))

    def _kept(self, velocity: Array) -> Array:
        """Factor on the deflection in one step."""
        limit = self._coulomb + self._extra * np.exp(-((velocity / self._stribeck) ** 2))
        return 1 / (1 + self._step * self._stiffness * np.abs(velocity) / limit)

    def _torque(self, deflection: Array, before: Array) -> Array:
        return self._stiffness * deflection + self._damping / self._step * (deflection - before)
