"""Reaction of an axis to the loss of its host: the abort connection option 6007h, on any fieldbus."""

from simulator.drive.axis import Axis
from simulator.drive.dictionary import Dictionary
from simulator.drive.errors import ErrorCode


def lose_host(axis: Axis, dictionary: Dictionary) -> None:
    """React as set in 6007h, with the commissioned speed control. An axis without torque already stands."""
    axis.speed_control.restore()
    match dictionary[0x6007, 0] if axis.energised else 0:
        case 1:
            axis.fail(ErrorCode.HEARTBEAT)
        case 2:
            axis.disable_voltage()
        case 3:
            axis.quick_stop()
        case _:
            pass
