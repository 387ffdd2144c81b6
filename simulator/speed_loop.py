"""The PI speed controller of the plant, for rows of arrays or for one row in floats (`train_step` says why both)."""

from dataclasses import dataclass
from typing import Generic

from simulator.train_step import FLOATS, Array, Reckoning, Value


@dataclass(slots=True)
class SpeedLoop(Generic[Value]):
    """Torque in N m, speeds in rad/s of the joint."""

    gain: Value  # N m s/rad
    reset: Value  # N m s/rad in a step
    limit: Value
    integral: Value
    reckoning: Reckoning[Value]

    def alone(self: "SpeedLoop[Array]", row: int) -> "SpeedLoop[float]":
        """That of one row, in floats."""
        gain, reset, limit, integral = (float(part[row]) for part in (self.gain, self.reset, self.limit, self.integral))
        return SpeedLoop(gain, reset, limit, integral, FLOATS)

    def effort(self, setpoint: Value, velocity: Value, injected: Value) -> Value:
        """PI and injected torque within the limit; the integrator gives way while it holds (back-calculation)."""
        error = setpoint - velocity
        integral = self.integral + self.reset * error
        wanted = self.gain * error + integral + injected
        effort = self.reckoning.within(wanted, -self.limit, self.limit)
        self.integral = integral + effort - wanted
        return effort
