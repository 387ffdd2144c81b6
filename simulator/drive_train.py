"""Drive trains, one row each, stepped together: motor and load with a spring between them, or one rigid mass.

    Jm vm' = u - Ts - fm(vm) - cogging(qm)          Ts = k e + k3 e^3 + d e',  e = qm - ql
    Jl vl' = Ts - fl(vl) - gravity(ql)              f(v) = mu v + Fc sign(v)

Leapfrog: positions and effort at the steps n, velocities half-way between, so effort u_n, position q_n and velocity
(v_{n-1/2} + v_{n+1/2})/2 belong to one instant to second order. Viscous and structural damping are trapezoidal. Coulomb
friction is the exact solution of the set-valued law over a step, v <- v - clip(v, -c, c): it sticks and never chatters.
A rigid mass thus obeys Gamma/Omega = (2J/h) i tan(wh/2) + mu, 5e-6 from iwJ at 5 Hz and h = 0.25 ms.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.moving_axis import MovingAxis
from simulator.scenario import LuGre

Array = NDArray[np.float64]


class DriveTrains:
    """State and one step of many rows. `position` and `velocity` are (masses, rows): motor first, load last."""

    def __init__(self, axes: Sequence[MovingAxis], step: float) -> None:
        trains = [axis.train for axis in axes]
        springs = [train.spring for train in trains if train.spring is not None]
        if 0 < len(springs) < len(trains):
            raise ValueError("rigid and elastic drive trains cannot share a batch")
        self.elastic = bool(springs)
        rows, masses = len(axes), 2 if self.elastic else 1
        self.position = np.zeros((masses, rows))
        self.velocity = np.zeros((masses, rows))
        self.free = np.zeros(rows)  # 1 where the brake is open
        self._force = np.zeros((masses, rows))
        self._step = step

        self._stiffness = np.array([spring.stiffness for spring in springs])
        self._hardening = np.array([spring.hardening for spring in springs])
        self._hardens = bool(self._hardening.any())
        self.damping = np.array([spring.damping for spring in springs])
        viscous = np.array([[train.motor_friction.viscous, train.load_friction.viscous] for train in trains]).T
        coulomb = np.array([[train.motor_friction.coulomb, train.load_friction.coulomb] for train in trains]).T
        self._viscous, self._coulomb = self._masses(viscous), self._masses(coulomb)
        self._cogging = cogging(axes)
        self._bristles = Bristles([t.lugre for t in trains], step) if any(t.lugre for t in trains) else None
        self.load(axes)

    def load(self, axes: Sequence[MovingAxis]) -> None:
        """Take over inertia and gravity of another pose; the drive trains and their state stay."""
        inertia = self._masses(np.array([[axis.motor_inertia, axis.load_inertia] for axis in axes]).T)
        half = self._step * self._viscous / 2
        self._mobility = self._step / (inertia + half)  # velocity gained per N m in one step
        self._keep = (inertia - half) / (inertia + half)
        self._stick = self._mobility * self._coulomb
        self._slip = -self._stick
        if self.elastic:
            drag = self.damping * self._step / 2
            impulse = drag / (1 + drag * self._mobility.sum(axis=0) / self._step)
            # velocity that the motor loses and the load gains per sum of old and new relative velocity
            self._drag = self._mobility / self._step * np.stack([impulse, -impulse])
        gravity = [axis.gravity for axis in axes]
        self._gravity = np.array([np.hypot(g.cosine, g.sine) for g in gravity])
        self._gravity_phase = np.array([np.arctan2(g.cosine, g.sine) for g in gravity])
        self._gravity_constant = np.array([g.constant for g in gravity])

    def _masses(self, values: Array) -> Array:
        """(motor and load, rows) -> one row of values for each mass."""
        return values if self.elastic else values.sum(axis=0, keepdims=True)

    def gravity(self) -> Array:
        """Gravity torque at the present load position, (rows,) N m."""
        return self._gravity * np.sin(self.position[-1] + self._gravity_phase) + self._gravity_constant

    def spring_torque(self) -> Array:
        """Torque of the springs alone, without their damping, (rows,) N m."""
        twist = self.position[0] - self.position[1]
        return (self._stiffness + self._hardening * (twist * twist) if self._hardens else self._stiffness) * twist

    def settle(self, row: int) -> float:
        """Put the load of a standing row where the spring holds gravity; returns the torque the motor needs, N m."""
        self.velocity[:, row] = 0.0
        if self._bristles is not None:
            self._bristles.deflection[row] = 0.0
        if self.elastic:
            twist = 0.0
            for _ in range(30):  # contracts by gravity stiffness over spring stiffness, about 1e-2 a round
                self.position[1, row] = self.position[0, row] - twist
                twist = self.gravity()[row] / (self._stiffness[row] + self._hardening[row] * twist**2)
        return float(self.gravity()[row])

    def step(self, effort: Array) -> None:
        """Advance every row by one step under motor torque `effort` (rows,), N m."""
        force, position, velocity = self._force, self.position, self.velocity
        motor = effort
        if self._cogging is not None:
            motor = motor - self._cogging(position[0])
        if self._bristles is not None:
            motor = motor - self._bristles.step(velocity[0])
        if self.elastic:
            spring = self.spring_torque()
            np.subtract(motor, spring, out=force[0])
            np.subtract(spring, self.gravity(), out=force[1])
            drift = velocity[0] - velocity[1]
        else:
            np.subtract(motor, self.gravity(), out=force[0])
            drift = None
        velocity *= self._keep
        force *= self._mobility
        velocity += force
        if drift is not None:
            drift += velocity[0]
            drift -= velocity[1]
            velocity -= self._drag * drift
        velocity -= np.minimum(np.maximum(velocity, self._slip), self._stick)
        velocity *= self.free
        position += self._step * velocity


class Bristles:
    """LuGre friction of the rows that have it; others feel none. z is stepped implicitly, so any speed is stable."""

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
        limit = self._coulomb + self._extra * np.exp(-((velocity / self._stribeck) ** 2))
        rate = self._stiffness * np.abs(velocity) / limit
        before = self.deflection
        self.deflection = (before + self._step * velocity) / (1 + self._step * rate)
        return self._stiffness * self.deflection + self._damping / self._step * (self.deflection - before)


def cogging(axes: Sequence[MovingAxis]) -> Callable[[Array], Array] | None:
    """Sum of the ripples as a function of the motor position (rows,) on the joint side; None if no row has one."""
    most = max(len(axis.train.cogging) for axis in axes)
    if most == 0:
        return None
    order, amplitude, phase = np.zeros((3, most, len(axes)))
    for row, axis in enumerate(axes):
        for k, ripple in enumerate(axis.train.cogging):
            order[k, row] = ripple.order * axis.gear_ratio
            amplitude[k, row] = ripple.amplitude
            phase[k, row] = ripple.phase

    def torque(position: Array) -> Array:
        return (amplitude * np.sin(order * position + phase)).sum(axis=0)

    return torque
