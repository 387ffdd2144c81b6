"""The third plant: one axis, an inertia with friction under a PI speed controller, in equations of its own.

J w' = M - Fc tanh(w / w0) - Fv w; SI units of the joint. The torque is constant over a step, viscous friction is taken
at its middle, and so is the speed that TPDOs report: mean torque and mean speed are then of the same time. (With
explicit Euler, and the speed of the end of the step, J came out 0.27 % low.)
"""

import math
import random
from dataclasses import dataclass, field

STEP = 2.5e-4  # s
SLOPE = 2e-3  # rad/s: below it Coulomb's friction is a viscous one
BANDWIDTH, RESET = 25.0, 5.0  # Hz, of the speed controller and its integrator
STIFFNESS = 10.0  # 1/s, of the position controller
NOISE = 1.0  # per mille of the rated torque, of the told torque


@dataclass
class Plant:
    """Without energy the brake holds. `effort_limit` N m."""

    inertia: float
    coulomb: float
    viscous: float
    effort_limit: float = math.inf
    position: float = 0.0
    velocity: float = 0.0
    effort: float = 0.0
    mean_velocity: float = 0.0  # over the last step
    _sum: float = 0.0  # of the controller's integrator, N m
    noise: random.Random = field(default_factory=lambda: random.Random(1))

    def stand(self) -> None:
        """The brake is closed."""
        self.velocity = self.mean_velocity = self.effort = self._sum = 0.0

    def step(self, wanted: float) -> None:
        """One `STEP` at a speed set-point, rad/s."""
        gain = self.inertia * math.tau * BANDWIDTH
        error = wanted - self.velocity
        effort = gain * error + self._sum
        self.effort = min(max(effort, -self.effort_limit), self.effort_limit)
        if effort == self.effort:  # no wind-up in the limit
            self._sum += gain * math.tau * RESET * error * STEP
        before, dry = self.velocity, self.coulomb * math.tanh(self.velocity / SLOPE)
        momentum, half = self.inertia / STEP, self.viscous / 2
        self.velocity = ((momentum - half) * before + self.effort - dry) / (momentum + half)
        self.mean_velocity = (before + self.velocity) / 2
        self.position += self.mean_velocity * STEP
