"""The speed control of the drive (2140h): active gain and reset time, and their commissioned values."""

from drivers.canopen.objects import Entry
from drivers.canopen.sdo import Sdo

GAIN = Entry(0x2140, 1, "d", "active gain")
RESET_TIME = Entry(0x2140, 2, "d", "active reset time")
COMMISSIONED_GAIN = Entry(0x2140, 3, "d", "commissioned gain")
COMMISSIONED_RESET_TIME = Entry(0x2140, 4, "d", "commissioned reset time")


def soften(sdo: Sdo, softening: float) -> None:
    """Gain times `softening`, reset time divided by it. Raises WrongConfiguration if the drive does not hold them."""
    sdo.settle(GAIN, sdo.read(COMMISSIONED_GAIN) * softening)
    sdo.settle(RESET_TIME, sdo.read(COMMISSIONED_RESET_TIME) / softening)


def restore(sdo: Sdo) -> str | None:
    """Make the commissioned values active. Returns a description of what had to be changed; None if nothing."""
    changed: list[str] = []
    for active, commissioned in ((GAIN, COMMISSIONED_GAIN), (RESET_TIME, COMMISSIONED_RESET_TIME)):
        wanted, found = sdo.read(commissioned), sdo.read(active)
        if found != wanted:
            sdo.settle(active, wanted)
            changed.append(f"{active.name} {found:.4g} instead of {wanted:.4g}")
    return ", ".join(changed) or None
