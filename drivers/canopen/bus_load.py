"""How full the bus is in a streamed sweep: SYNC, set-points, answers and heartbeats at the bit rate. Pure."""

import math
from collections.abc import Iterable

from drivers.canopen.configuration import Pdo
from drivers.canopen.device_map import bits
from drivers.canopen.profile import BusProfile
from drivers.errors import LimitExceeded

MOST = 0.7  # of the bit rate: the rest is for SDO, EMCY, repeated frames


def frame_bits(size: int) -> int:
    """Of a data frame with an 11-bit identifier and `size` bytes: the longest, with interframe space (ISO 11898-1).

    From the start bit to the check sum 34 bits and the data are stuffed, at worst after every fourth; 13 bits are not.
    """
    return 34 + 8 * size + (34 + 8 * size - 1) // 4 + 13


def check_bus_load(settings: BusProfile, moving: Iterable[tuple[Pdo, ...]], nodes: int) -> None:
    """LimitExceeded where sweeps of axes with these PDOs need more than 70 % of the bit rate, with the cycle that fits.

    `stop` frames are not counted, for they come once. Nothing is checked where the profile has no bit rate.
    """
    if settings.bitrate is None:
        return
    sizes = [sum(bits(entry) for entry in pdo.mapped) // 8 for pdos in moving for pdo in pdos]
    cycle = frame_bits(0) + sum(frame_bits(size) for size in sizes)
    heartbeats = frame_bits(1) * (1 / settings.host_heartbeat + nodes / settings.drive_heartbeat)
    load = (cycle / settings.sync_period + heartbeats) / settings.bitrate
    if load <= MOST:
        return
    left = MOST * settings.bitrate - heartbeats
    fits = f"sync_period {math.ceil(cycle / left * 1e3) * 1e-3:g} s fits" if left > 0 else "no sync_period fits"
    raise LimitExceeded(
        f"bus {settings.channel}: a sweep of these axes takes {load:.0%} of {settings.bitrate} bit/s, "
        f"{MOST:.0%} are allowed; {fits}"
    )
