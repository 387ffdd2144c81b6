"""Two TPDOs of one SYNC -> one sample, numbered by the drive's own counter. Pure.

Only TPDO2 carries the counter. A TPDO1 belongs to the same SYNC if the number of TPDO1 since the last TPDO2 equals
the advance of the counter, because the frames of a node keep their order on CAN. A TPDO1 that arrives when every
SYNC is already answered is late and is not counted; one that repeats the previous one may be a duplicated frame and
need not be counted.

Any single frame that is lost, duplicated or late therefore causes a gap, never a mixed sample. One case remains: a
TPDO1 is lost *and* a late frame arrives in its place. Such a sample lies within two SYNCs of a gap, which makes the
recording invalid.
"""

from dataclasses import dataclass

from drivers.canopen.frames import MotionPdo, PositionPdo

WORD = 0xFFFFFFFF
LONGEST_GAP = 10_000  # SYNCs; a counter that jumps further, or back, does not belong to this sweep


@dataclass(frozen=True, slots=True)
class Sample:
    """Values of an axis at one SYNC, drive units; `index` counts the SYNCs since the counter was read."""

    index: int
    statusword: int
    velocity: int
    torque: int
    position: int


class Pairing:
    """Combines TPDO1 and TPDO2 of one axis."""

    def __init__(self, counter: int) -> None:
        """`counter` is 2120h:01 before the first SYNC."""
        self._counter = counter
        self._index = -1  # of the last TPDO2 that was counted
        self._motion: MotionPdo | None = None
        self._motions = 0  # number of TPDO1 since that TPDO2
        self._different = 0  # number of these that differ from the previous one
        self._syncs = 0

    @property
    def ahead(self) -> int:
        """SYNCs counted by the drive minus SYNCs sent; if positive, another host sent some."""
        return self._index + 1 - self._syncs

    def sync(self) -> None:
        """A SYNC was sent."""
        self._syncs += 1

    def motion(self, event: MotionPdo) -> None:
        if self.ahead >= 0:
            return
        self._motions += 1
        self._different += event != self._motion or self._different == 0
        self._motion = event

    def position(self, event: PositionPdo) -> Sample | None:
        """The sample that this TPDO2 completes; None if it was already received, or if its TPDO1 is not certain."""
        advance = (event.counter - self._counter) & WORD
        if not 0 < advance <= LONGEST_GAP:
            return None
        motion, motions, different = self._motion, self._motions, self._different
        self._counter = event.counter
        self._index += advance
        self._motions = self._different = 0
        if motion is None or not different <= advance <= motions:
            return None
        return Sample(self._index, motion.statusword, motion.velocity, motion.torque, event.position)
