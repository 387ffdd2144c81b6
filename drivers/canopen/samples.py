"""Two TPDOs of one SYNC -> one sample: by the drive's own counter, or by the SYNC after which they came. Pure."""

from dataclasses import dataclass

from drivers.canopen.frames import MotionPdo, PositionPdo


@dataclass(frozen=True, slots=True)
class SyncSample:
    """Values of an axis at one SYNC, drive units; `index` counts the SYNCs since the counter was read."""

    index: int
    statusword: int
    velocity: int
    torque: int
    position: int


class CounterPairing:
    """Combines TPDO1 and TPDO2 of one axis by the drive's own counter.

    Only TPDO2 carries the counter. A TPDO1 belongs to the same SYNC if the number of TPDO1 since the last TPDO2 equals
    the advance of the counter, because the frames of a node keep their order on CAN. A TPDO1 that arrives when every
    SYNC is already answered is late and is not counted; one that repeats the previous one may be a duplicated frame and
    need not be counted.

    Any single frame that is lost, duplicated or late therefore causes a gap, never a mixed sample. One case remains: a
    TPDO1 is lost *and* a late frame arrives in its place. Such a sample lies within two SYNCs of a gap, which makes the
    recording invalid.
    """

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

    def position(self, event: PositionPdo) -> SyncSample | None:
        """The sample that this TPDO2 completes; None if it was already received, or if its TPDO1 is not certain."""
        advance = (event.counter - self._counter) & 0xFFFFFFFF
        if not 0 < advance <= 10_000:  # a counter that jumps further, or back, does not belong to this sweep
            return None
        motion, motions, different = self._motion, self._motions, self._different
        self._counter = event.counter
        self._index += advance
        self._motions = self._different = 0
        if motion is None or not different <= advance <= motions:
            return None
        return SyncSample(self._index, motion.statusword, motion.velocity, motion.torque, event.position)


class Windows:
    """Combines TPDO1 and TPDO2 of one axis by the SYNC after which they arrived, for drives that count no samples.

    The answers to a SYNC arrive after it and before the next one: this interval is the window of the SYNC. TPDO1 and
    TPDO2 both contain the velocity at their SYNC, so two frames that disagree belong to different SYNCs. A window gives
    a sample if it holds one TPDO1 and one TPDO2 that agree. Anything else is a gap. After a gap no sample is accepted
    until two consecutive windows agree with different velocities: a frame that is one cycle late would then have
    disagreed.

    Therefore, with frames late by up to one cycle:

    - A lost, late or duplicated frame of one TPDO is a gap, never a mixed sample.
    - If both answers to a SYNC are missing, their loss cannot be distinguished from all later answers being one cycle
      late. Samples continue after the gap. Late answers are detected at the end, as more frames than SYNCs (the host
      leaves out one SYNC after the last sample for this reason): `doubt` then states it, and the sweep is void.
    - If the host waits with the next SYNC until all drives have answered (`settle`), even that is certain: a frame that
      is missing then is lost.

    These cases remain: a late *duplicated* frame arrives in place of a lost one with exactly the same velocity; both
    answers are late in a row of SYNCs that ends with the loss of both; both answers to a SYNC arrive more than one
    cycle late. In the last two cases both values of a sample belong to one SYNC nevertheless, and the window limits the
    error of its number.
    """

    ahead = 0  # without a counter the drive cannot be ahead

    def __init__(self) -> None:
        self.doubt: str | None = None
        """Why delivered samples may belong to another SYNC than stated."""
        self._syncs = 0
        self._motions: list[MotionPdo] = []
        self._places: list[PositionPdo] = []
        self._settled = False  # frames of the open and earlier windows have arrived, or are lost
        self._certain = True  # so far
        self._agreed: int | None = None  # velocity of the previous window, if its frames agreed
        self._owed_motions = self._owed_places = 0  # frames that are missing and may be late
        self._risked: int | None = None  # first sample delivered while both kinds were missing

    @property
    def answered(self) -> bool:
        """Both TPDOs arrived after the last SYNC."""
        return bool(self._motions and self._places)

    def motion(self, event: MotionPdo) -> None:
        self._motions.append(event)

    def position(self, event: PositionPdo) -> None:
        self._places.append(event)

    def settle(self) -> None:
        """So much time has passed since the last SYNC that no answer is pending any more."""
        self._settled = True

    def sync(self) -> SyncSample | None:
        """The next SYNC is sent. Returns the sample of the previous one, None if there is a gap."""
        sample = self._close() if self._syncs else None
        self._motions.clear()
        self._places.clear()
        self._settled = False
        self._syncs += 1
        return sample

    def _close(self) -> SyncSample | None:
        motions, places, index = self._motions, self._places, self._syncs - 1
        if max(len(motions), len(places)) > 1 and self._risked is not None:
            self.doubt = f"answers to SYNC came a cycle late since sample {self._risked}"
        self._owed_motions = max(0, self._owed_motions + 1 - len(motions))
        self._owed_places = max(0, self._owed_places + 1 - len(places))
        good = len(motions) == len(places) == 1 and motions[0].velocity == places[0].velocity
        agreed, self._agreed = self._agreed, motions[0].velocity if good else None
        proven = good and agreed is not None and agreed != self._agreed
        if proven and min(self._owed_motions, self._owed_places) == 0:
            self._owed_motions = self._owed_places = 0  # the other kind is in step: the missing frames were lost
        if self._settled:
            self._owed_motions = self._owed_places = 0
        believed = good and (self._certain or proven or self._settled)
        lost = self._settled and len(motions) + len(places) <= 1
        self._certain = believed or lost
        if not min(self._owed_motions, self._owed_places):
            self._risked = None
        elif believed and self._risked is None:
            self._risked = index
        if not believed:
            return None
        motion, place = motions[0], places[0]
        return SyncSample(index, motion.statusword, motion.velocity, motion.torque, place.position)
