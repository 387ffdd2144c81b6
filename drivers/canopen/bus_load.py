"""Load of the bus in a streamed sweep: SYNC, set-points, answers and heartbeats relative to the bit rate. Pure."""

import math
from collections.abc import Iterable

from drivers.canopen.configuration import Pdo
from drivers.canopen.device_map import bits
from drivers.canopen.profile import BusProfile
from drivers.errors import LimitExceeded

MOST = 0.7  # share of the bit rate; the rest is for SDO, EMCY, repeated frames


def frame_bits(size: int) -> int:
    """Longest data frame with an 11-bit identifier and `size` bytes, including interframe space (ISO 11898-1), in bits.

    The 34 bits from start bit to checksum and the data are stuffed, in the worst case after every fourth bit. 13
    bits are not stuffed.
    """
    return 34 + 8 * size + (34 + 8 * size - 1) // 4 + 13


def bus_load(settings: BusProfile, moving: Iterable[tuple[Pdo, ...]], nodes: int) -> float:
    """Share of the bit rate that a streamed sweep of axes with these PDOs uses; 0 if the profile has no bit rate.

    `stop` frames are not counted, because they are sent once.
    """
    if settings.bitrate is None:
        return 0.0
    return (_cycle(moving) / settings.sync_period + _heartbeats(settings, nodes)) / settings.bitrate


def check_bus_load(settings: BusProfile, moving: Iterable[tuple[Pdo, ...]], nodes: int) -> None:
    """Raises LimitExceeded if sweeps of axes with these PDOs need more than 70 % of the bit rate. States the cycle that
    fits.

    Nothing is checked if the profile has no bit rate.
    """
    if settings.bitrate is None:
        return
    moving = tuple(moving)
    load = bus_load(settings, moving, nodes)
    if load <= MOST:
        return
    left = MOST * settings.bitrate - _heartbeats(settings, nodes)
    fits = (
        f"sync_period {math.ceil(_cycle(moving) / left * 1e3) * 1e-3:g} s fits" if left > 0 else "no sync_period fits"
    )
    raise LimitExceeded(
        f"bus {settings.channel}: a sweep of these axes takes {load:.0%} of {settings.bitrate} bit/s, "
        f"{MOST:.0%} are allowed; {fits}"
    )


def _cycle(moving: Iterable[tuple[Pdo, ...]]) -> int:
    """Bits of one cycle: SYNC and the PDOs of the moving axes."""
    sizes = [sum(bits(entry) for entry in pdo.mapped) // 8 for pdos in moving for pdo in pdos]
    return frame_bits(0) + sum(frame_bits(size) for size in sizes)


def _heartbeats(settings: BusProfile, nodes: int) -> float:
    """Bits per second."""
    return frame_bits(1) * (1 / settings.host_heartbeat + nodes / settings.drive_heartbeat)
