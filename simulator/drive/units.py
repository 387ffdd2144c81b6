"""Units of the dictionary against rev and rev/s of the motor (docs/reference/virtual-drive.md, "Units")."""

INCREMENTS = 1 << 20
"""Position: increments a motor revolution, 608Fh."""

SPEED = 60_000
"""Speed and acceleration: 10^-3 rev/min (a second) in 1 rev/s (a second), 60A9h."""

PER_MILLE = 1000
"""Torque in parts of the rated torque 6076h, which is in 10^-3 N m."""


def clamp(value: float, bits: int) -> int:
    """The nearest signed integer of `bits` bits."""
    top = (1 << (bits - 1)) - 1
    return max(-top - 1, min(top, round(value)))
