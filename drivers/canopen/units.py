"""Drive units on the motor side <-> SI on the joint side, by the unit objects of the drive."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.canopen.device_map import SPEEDS, DeviceUnits
from drivers.canopen.profile import CanopenAxis
from drivers.cia402.profile import Gear
from drivers.errors import LimitExceeded, WrongConfiguration
from drivers.ports import Array


@dataclass(frozen=True, slots=True)
class Codec(Gear):
    """One axis' conversions. Raw values are the integers on the wire; `rated_torque` is that of 6076h."""

    increments: float  # per motor revolution, 608Fh; divided by the gear ratio if the drive counts on the joint side
    velocity_unit: float  # motor rev/s per raw unit, 60A9h
    acceleration_unit: float | None = None  # motor rev/s^2 per raw unit; None: velocity units per s
    max_speed_unit: float | None = None  # motor rev/s per raw unit of 6080h; None: velocity units
    rated_effort: float | None = None  # N m of the motor at 1000 per mille; None: rated torque

    def position(self, raw: Array | float) -> Array:
        """6064h -> rad (m)."""
        return self.motor_position(np.asarray(raw) / self.increments)

    def velocity(self, raw: Array | float) -> Array:
        """606Ch -> rad/s (m/s)."""
        return np.asarray(raw) * (self.velocity_unit * math.tau / self.gear_ratio)

    def effort(self, raw: Array | float) -> Array:
        """6077h, per mille of rated torque (6078h: of rated current) -> N m (N)."""
        rated = self.rated_torque if self.rated_effort is None else self.rated_effort
        return np.asarray(raw) * (1e-3 * rated * self.gear_ratio)

    def raw_position(self, position: float) -> int:
        """rad (m) -> increments; LimitExceeded beyond 32 bits."""
        return _int32((position - self.position_offset) * self.gear_ratio / math.tau * self.increments, "position")

    def raw_velocity(self, velocity: float) -> int:
        """rad/s (m/s) -> 60A9h units, signed; LimitExceeded beyond 32 bits."""
        return _int32(velocity * self.gear_ratio / math.tau / self.velocity_unit, "velocity")

    def raw_speed(self, speed: float) -> int:
        """Magnitude of a speed, rad/s (m/s) -> 60A9h units; LimitExceeded beyond 32 bits."""
        return abs(self.raw_velocity(speed))

    def raw_acceleration(self, acceleration: float) -> int:
        """rad/s^2 (m/s^2) -> drive units, at least 1."""
        if self.acceleration_unit is None:
            return self.raw_speed(acceleration)
        return max(1, abs(_int32(acceleration * self.gear_ratio / math.tau / self.acceleration_unit, "acceleration")))

    def raw_max_speed(self, speed: float) -> int:
        """Magnitude of a speed in the unit of 6080h."""
        if self.max_speed_unit is None:
            return self.raw_speed(speed)
        return math.ceil(abs(speed * self.gear_ratio / math.tau / self.max_speed_unit))

    def raw_effort_limit(self, effort: float) -> int:
        """N m (N) -> per mille of rated torque, rounded down, at most the 16-bit maximum."""
        return min(math.floor(self.permille(effort)), 0xFFFF)

    def raw_window(self, window: tuple[float, float]) -> tuple[int, int]:
        """Joint limits, rad (m) -> increments, low before high for either sign of the gear ratio, of 32 bits."""
        scale = self.gear_ratio / math.tau * self.increments
        low, high = sorted((limit - self.position_offset) * scale for limit in window)
        return max(math.floor(low), -(2**31)), min(math.ceil(high), 2**31 - 1)


def codec(axis: CanopenAxis, units: DeviceUnits, rated_torque: float, read: Callable[[str], float]) -> Codec:
    """Built from the unit objects of the drive, the map and the profile; `read` returns an object of the map.
    `rated_torque` N m.

    Raises WrongConfiguration for unknown units.
    """
    turn = axis.gear_ratio if units.side == "joint" else 1.0  # motor revolutions per revolution of the counted side
    if units.increments == "608Fh":
        increments = read("increments") / max(1.0, read("motor_revolutions")) / turn
    elif units.increments == "profile":
        increments = axis.increments or math.nan  # never NaN: the profile check requires it
    else:
        increments = units.increments / turn

    def speed(unit: str) -> float | None:
        """Motor rev/s per raw unit; None: as the velocity."""
        if unit == "60A9h":
            return velocity_unit(int(read("velocity_unit")), increments * turn) * turn
        if unit == "increments/s":
            return 1 / increments
        known = SPEEDS.get(unit)
        return None if known is None else known * turn

    rated = None
    if units.effort == "current":
        rated = read("rated_current") * 1e-3 * (axis.torque_constant or math.nan)  # never NaN: see above
    return Codec(
        gear_ratio=axis.gear_ratio,
        position_offset=axis.position_offset,
        rated_torque=rated_torque,
        increments=increments,
        velocity_unit=speed(units.velocity) or 0.0,
        acceleration_unit=speed(units.acceleration),
        max_speed_unit=speed(units.max_speed),
        rated_effort=rated,
    )


def velocity_unit(code: int, increments: float) -> float:
    """60A9h -> motor rev/s per raw unit. WrongConfiguration unless it is revolutions (B4h) or increments (B5h) per s
    (03h) or min (47h).
    """
    prefix = (code >> 24) - 256 if code >> 31 else code >> 24
    numerator, denominator = (code >> 16) & 0xFF, (code >> 8) & 0xFF
    revolutions = {0xB4: 1.0, 0xB5: 1.0 / increments}.get(numerator)
    seconds = {0x03: 1.0, 0x47: 60.0}.get(denominator)
    if revolutions is None or seconds is None or not -9 <= prefix <= 9:
        raise WrongConfiguration(f"60A9h: velocity unit {code:08X}h is not 10^x rev or increments per s or min")
    return 10.0**prefix * revolutions / seconds


def _int32(value: float, what: str) -> int:
    if not abs(value) < 2**31 - 1:
        raise LimitExceeded(f"{what} {value:.6g} in drive units does not fit 32 bits")
    return round(value)
