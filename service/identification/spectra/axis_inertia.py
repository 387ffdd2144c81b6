r"""The drive train of one axis in the frequency domain, and the paper's formula for comparison.

Effort over motor velocity of two masses and a spring, friction on both sides, all on the joint side, s = i omega
(compliance form, so that a stiff train is simply c = 0):

    Z = s Jm + mu_m + Z_l F,   Z_l = s J_l + mu_l + k_g / s,   F = 1 / (1 + Y Z_l),   Y = s c / (1 + s h)

c = 1/k compliance [rad/(N m)], h = d/k time constant of the damping [s], k_g gravity stiffness [N m/rad]. F is also
the motor torque per torque on the load. Well below the locked-rotor frequency  Im Z / omega  tends to
Jm + J_l, the axis inertia.

The paper's equation (8) assumes a rigid train and uses |Im Z| at one line: `paper_inertia`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class DriveTrain:
    """Parameters shared by all poses of an axis; SI on the joint side. Order of `as_array` and of all derivatives."""

    motor_inertia: float  # kg m^2 (kg), reflected
    motor_friction: float  # N m s/rad (N s/m)
    load_friction: float
    compliance: float  # rad/(N m) (m/N)
    damping_time: float  # s

    def as_array(self) -> Array:
        return np.array(
            [self.motor_inertia, self.motor_friction, self.load_friction, self.compliance, self.damping_time]
        )

    def locked_rotor_frequency(self, load_inertia: float) -> float:
        """1/(2 pi) sqrt(k / J_l), Hz; inf for a stiff train, or if noise makes J_l zero or negative."""
        if self.compliance <= 0 or load_inertia <= 0:
            return float("inf")
        return float(1 / np.sqrt(self.compliance * load_inertia) / (2 * np.pi))


@dataclass(frozen=True, slots=True)
class Impedance:
    """Z and F at some frequencies (..., b), with the terms needed for their derivatives."""

    s: Complex
    load: Complex  # Z_l
    spring: Complex  # Y
    through: Complex  # F
    total: Complex  # Z

    def by_load(self, velocity: Complex, on_load: Complex) -> Complex:
        """d(Z velocity + F on_load) / d Z_l, (..., b)."""
        return self.through**2 * (velocity - self.spring * on_load)

    def by_spring(self, velocity: Complex, on_load: Complex) -> Complex:
        """d(Z velocity + F on_load) / d Y, (..., b)."""
        return -(self.through**2) * self.load * (self.load * velocity + on_load)


def impedance(
    frequency: Array, train: DriveTrain, load_inertia: float | Array, gravity_stiffness: float | Array
) -> Impedance:
    """The two-mass impedance at `frequency` (..., b), Hz; the load parameters broadcast against it."""
    s: Complex = np.multiply(2j * np.pi, frequency, dtype=np.complex128)
    load = s * load_inertia + train.load_friction + gravity_stiffness / s
    spring = s * train.compliance / (1 + s * train.damping_time)
    through = 1 / (1 + spring * load)
    return Impedance(s, load, spring, through, s * train.motor_inertia + train.motor_friction + load * through)


def paper_inertia(frequency: float, response: complex) -> float:
    """Equation (8) of the paper from the response Z = Gamma/Omega at `frequency`, Hz: kg m^2 (kg)."""
    phase = np.angle(1 / response)
    return float(abs(response) / (2 * np.pi * frequency) / np.sqrt(1 + 1 / np.tan(phase) ** 2))
