"""Two TPDOs of one SYNC -> one sample, numbered by the drive's own counter. Pure.

Only TPDO2 carries the counter. A TPDO1 is of the same SYNC if as many TPDO1 have come since the last TPDO2 as the
counter advanced, for a node's frames keep their order on CAN. A TPDO1 that comes when every SYNC is already answered is
late and not counted; one that repeats the one before may be a doubled frame and need not be counted.

What any one frame lost, doubled or late can do is thereby a gap, never a mixed sample. What remains: one TPDO1 is lost
*and* a late frame comes just in its place. Such a sample lies within two SYNCs of a gap, which spoils the recording.
"""

from dataclasses import dataclass

from drivers.canopen.frames import MotionPdo, PositionPdo

WORD = 0xFFFFFFFF
LONGEST_GAP = 10_000  # SYNCs; a counter that jumps further, or back, has nothing to do with this sweep


@dataclass(frozen=True, slots=True)
class Sample:
    """What an axis said at one SYNC, drive units; `index` counts the SYNCs since the counter was read."""

    index: int
    statusword: int
    velocity: int
    torque: int
    position: int


class Pairing:
    """Joins TPDO1 and TPDO2 of one axis."""

    def __init__(self, counter: int) -> None:
        """`counter` is 2120h:01 before the first SYNC."""
        self._counter = counter
        self._index = -1  # of the last TPDO2 that counted
        self._motion: MotionPdo | None = None
        self._motions = 0  # since that TPDO2
        self._different = 0  # of them, from the one before
        self._syncs = 0

    @property
    def ahead(self) -> int:
        """By how much the drive has counted more SYNCs than were sent; a stranger's, if it is positive."""
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
        """The sample that this TPDO2 completes; None if it came before, or if its partner is not certain."""
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
