"""Two TPDOs of one SYNC -> one sample, and the sample's number from the drive's own counter. Pure."""

from dataclasses import dataclass

from drivers.canopen.frames import Motion, Place


@dataclass(frozen=True, slots=True)
class Sample:
    """What an axis said at one SYNC, drive units; `index` counts from the sweep's first SYNC."""

    index: int
    statusword: int
    velocity: int
    torque: int
    position: int


class Pairing:
    """Joins TPDO1 and TPDO2 of one axis.

    A lost TPDO leaves a hole in the counter, a doubled one changes nothing. A TPDO1 can meet a TPDO2 of the next
    SYNC only when two frames are lost, and then the counter shows the hole as well.
    """

    def __init__(self, counter: int) -> None:
        """`counter` is 2120h:01 before the first SYNC."""
        self._base = counter + 1
        self._last = -1
        self._motion: Motion | None = None

    def motion(self, event: Motion) -> None:
        self._motion = event

    def place(self, event: Place) -> Sample | None:
        """The sample that this TPDO2 completes; None if its partner is lost or it came before."""
        motion, self._motion = self._motion, None
        index = (event.counter - self._base) & 0xFFFFFFFF
        if motion is None or index <= self._last or index >= 0x80000000:
            return None
        self._last = index
        return Sample(index, motion.statusword, motion.velocity, motion.torque, event.position)
