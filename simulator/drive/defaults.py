"""Values that the drive uses internally if its EDS lacks the object: the same drive, but the object is not on the bus.

A drive without 607Dh has no position window except the range of its encoder. Limits of the motor (6072h, 6080h)
apply internally with or without an object.
"""

from collections.abc import Iterable

Key = tuple[int, int]

_SINES = range(1, 17)


def _zero(index: int, subs: Iterable[int]) -> dict[Key, int]:
    return {(index, sub): 0 for sub in subs}


ABSENT: dict[Key, int | float] = {
    (0x1001, 0): 0,
    **_zero(0x1003, range(9)),
    (0x1006, 0): 4000,
    (0x1016, 1): 0,
    (0x1017, 0): 0,
    **_zero(0x1018, range(1, 5)),
    (0x6007, 0): 1,
    (0x603F, 0): 0,
    (0x6040, 0): 0,
    (0x6041, 0): 0,
    (0x605A, 0): 2,
    (0x605B, 0): 1,
    (0x605C, 0): 1,
    (0x605D, 0): 1,
    (0x605E, 0): 2,
    (0x6060, 0): 0,
    (0x6061, 0): 0,
    (0x6064, 0): 0,
    (0x6065, 0): 1 << 20,
    (0x6066, 0): 100,
    (0x6067, 0): 1049,
    (0x606C, 0): 0,
    (0x6072, 0): 5000,
    (0x6076, 0): 1000,
    (0x6077, 0): 0,
    (0x607A, 0): 0,
    (0x607D, 1): -(1 << 31),
    (0x607D, 2): (1 << 31) - 1,
    (0x607F, 0): 0xFFFFFFFF,
    (0x6080, 0): 0xFFFFFFFF,
    (0x6081, 0): 0,
    (0x6083, 0): 1000,
    (0x6084, 0): 1000,
    (0x6085, 0): 5000,
    (0x60A9, 0): 0xFDB44700,  # 10^-3 rev/min
    (0x60C2, 1): 4,
    (0x60C2, 2): -3,
    (0x60E0, 0): 5000,
    (0x60E1, 0): 5000,
    (0x60FF, 0): 0,
    **_zero(0x2100, range(1, 13)),
    (0x2100, 0x0A): 4,
    **_zero(0x2101, _SINES),
    **_zero(0x2102, _SINES),
    **_zero(0x2103, _SINES),
    **_zero(0x2104, range(1, 5)),
    (0x2110, 1): 0,
    (0x2110, 2): 512,
    (0x2110, 3): 0,
    (0x2120, 1): 0,
    (0x2121, 1): 100,
    (0x2121, 2): 10,
    (0x2130, 1): 0,
    **_zero(0x2140, range(1, 5)),
}
