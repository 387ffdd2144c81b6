"""Signals of a register map in the drive: object of the dictionary and unit."""

from dataclasses import dataclass

from simulator.drive.dictionary import Dictionary, Key
from simulator.drive.units import INCREMENTS, speed_unit

ELEMENTS = 16
"""Number of elements of the signals in `ARRAYS`."""

CONSTANT = "constant"
WATCHDOG = "watchdog"
OWNER = "control_owner"

PAGE_RECORD = (
    ("cycle", "<u4", None),
    ("torque", "<f4", "N m"),
    ("set_speed", "<f4", "rev/min"),
    ("speed", "<f4", "rev/min"),
    ("position", "<f8", "rev"),
    ("load_position", "<f8", "rev"),
)
"""Fields of a trace sample in 2110h:03: (signal, NumPy type, unit)."""


@dataclass(frozen=True, slots=True)
class Signal:
    """`key` is that of the first element; None for a signal that is not in the dictionary."""

    key: Key | None
    unit: str | None = None


SIGNALS: dict[str, Signal] = {
    CONSTANT: Signal(None),
    "vendor": Signal((0x1018, 1)),
    "product": Signal((0x1018, 2)),
    "revision": Signal((0x1018, 3)),
    "serial": Signal((0x1018, 4)),
    "rated_torque": Signal((0x6076, 0), "N m"),
    "controlword": Signal((0x6040, 0)),
    "statusword": Signal((0x6041, 0)),
    "error_code": Signal((0x603F, 0)),
    "mode": Signal((0x6060, 0)),
    "mode_display": Signal((0x6061, 0)),
    "position": Signal((0x6064, 0), "rev"),
    "velocity": Signal((0x606C, 0), "rev/min"),
    "torque": Signal((0x6077, 0), "permille"),
    "target_position": Signal((0x607A, 0), "rev"),
    "profile_velocity": Signal((0x6081, 0), "rev/min"),
    "profile_acceleration": Signal((0x6083, 0), "rev/min/s"),
    "profile_deceleration": Signal((0x6084, 0), "rev/min/s"),
    "quick_stop_deceleration": Signal((0x6085, 0), "rev/min/s"),
    "max_torque": Signal((0x6072, 0), "permille"),
    "max_speed": Signal((0x6080, 0), "rev/min"),
    "position_min": Signal((0x607D, 1), "rev"),
    "position_max": Signal((0x607D, 2), "rev"),
    "quick_stop_option": Signal((0x605A, 0)),
    "shutdown_option": Signal((0x605B, 0)),
    "disable_option": Signal((0x605C, 0)),
    "halt_option": Signal((0x605D, 0)),
    "fault_option": Signal((0x605E, 0)),
    "connection_loss_option": Signal((0x6007, 0)),
    WATCHDOG: Signal(None, "ms"),
    OWNER: Signal(None),
    "measuring_command": Signal((0x2100, 1)),
    "measuring_state": Signal((0x2100, 2)),
    "measuring_reason": Signal((0x2100, 3)),
    "offset_speed": Signal((0x2100, 4), "rev/min"),
    "ramp": Signal((0x2100, 5), "s"),
    "settle": Signal((0x2100, 6), "s"),
    "period": Signal((0x2100, 7), "s"),
    "periods": Signal((0x2100, 8)),
    "sines": Signal((0x2100, 9)),
    "trace_cycle": Signal((0x2100, 0x0A), "ms"),
    "samples_recorded": Signal((0x2100, 0x0B)),
    "frequency": Signal((0x2101, 1), "Hz"),
    "amplitude": Signal((0x2102, 1), "rev/min"),
    "phase": Signal((0x2103, 1), "rad"),
    "page_first": Signal((0x2110, 1)),
    "page_count": Signal((0x2110, 2)),
}

ARRAYS = ("frequency", "amplitude", "phase")

_BY_SPEED_UNIT = (0x606C, 0x6080, 0x6081, 0x6083, 0x6084, 0x6085)
_INCREMENTS = (0x6064, 0x607A, 0x607D)


def factor(dictionary: Dictionary, key: Key) -> float:
    """Unit of the object relative to that of its signal: physical = value in the dictionary * factor."""
    index = key[0]
    if index in _BY_SPEED_UNIT:
        return 60 / speed_unit(dictionary)
    if index in _INCREMENTS:
        return 1 / INCREMENTS
    return 1e-3 if index == 0x6076 else 1.0
