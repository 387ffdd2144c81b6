"""The PI speed controller of the plant, for rows of arrays or for one row in floats (reason: see `train_step`)."""

from dataclasses import dataclass
from typing import Generic

from simulator.train_step import FLOATS, Arithmetic, Array, Value


@dataclass(slots=True)
class SpeedLoop(Generic[Value]):
    """Torque in N m, speeds in rad/s of the joint."""

    gain: Value  # N m s/rad
    reset: Value  # N m s/rad per step
    limit: Value
    integral: Value
    arithmetic: Arithmetic[Value]

    def alone(self: "SpeedLoop[Array]", row: int) -> "SpeedLoop[float]":
        """The controller of one row, in floats."""
        gain, reset, limit, integral = (float(part[row]) for part in (self.gain, self.reset, self.limit, self.integral))
        return SpeedLoop(gain, reset, limit, integral, FLOATS)

    def effort(self, setpoint: Value, velocity: Value, injected: Value) -> Value:
        """PI and injected torque within the limit; anti-windup by back-calculation at the limit."""
        error = setpoint - velocity
        integral = self.integral + self.reset * error
        wanted = self.gain * error + integral + injected
        effort = self.arithmetic.within(wanted, -self.limit, self.limit)
        self.integral = integral + effort - wanted
        return effort
