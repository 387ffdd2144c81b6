"""Two TPDOs of one SYNC -> one sample, for drives that count no samples. Pure.

What answers a SYNC comes after it and before the next: that is the window of the SYNC. TPDO1 and TPDO2 both tell the
velocity of their SYNC, so that two which disagree are known to be of different SYNCs. A window gives a sample if it
holds one TPDO1 and one TPDO2 that agree; anything else is a gap, and after a gap nothing is believed before two
windows in a row agree and tell different velocities: a frame late by a cycle then would have disagreed.

So, with frames late by up to a cycle:

- What is lost, late or doubled of one TPDO is a gap, never a mixed sample.
- When both answers to a SYNC are missing, their loss cannot be told from all answers being a cycle late from then on.
  Samples go on behind the gap. Answers that were late show at their end, as more frames than SYNCs (the host leaves
  out one SYNC after the last sample for this reason): `doubt` then says so, and the sweep is void.
- Where the host waits with the next SYNC until all have answered (`settle`), even that is certain: what has not come by
  then is lost.

What remains: a late *doubled* frame comes in place of a lost one that told the very same velocity; both answers are
late in a row of SYNCs that ends with the loss of both; both answers to a SYNC come more than a cycle late. In the last
two both values of a sample are of one SYNC all the same, and the window bounds by how much it is wrongly numbered.
"""

from drivers.canopen.frames import MotionPdo, PositionPdo
from drivers.canopen.samples import Sample


class Windows:
    """Joins TPDO1 and TPDO2 of one axis by the SYNC after which they came."""

    ahead = 0  # nothing counts that could be

    def __init__(self) -> None:
        self.doubt: str | None = None
        """Why samples that were given may be of another SYNC than it was said."""
        self._syncs = 0
        self._motions: list[MotionPdo] = []
        self._places: list[PositionPdo] = []
        self._settled = False  # what belongs to the open window and to those before is here, or lost
        self._certain = True  # so far
        self._agreed: int | None = None  # velocity told by the window before, if its frames agreed
        self._owed_motions = self._owed_places = 0  # that did not come, and may be late
        self._risked: int | None = None  # first sample given while both kinds were owed

    @property
    def answered(self) -> bool:
        """Both TPDOs came after the last SYNC."""
        return bool(self._motions and self._places)

    def motion(self, event: MotionPdo) -> None:
        self._motions.append(event)

    def position(self, event: PositionPdo) -> None:
        self._places.append(event)

    def settle(self) -> None:
        """So much time has passed since the last SYNC that no answer is under way any more."""
        self._settled = True

    def sync(self) -> Sample | None:
        """The next SYNC is sent: the sample of the one before, None where there is a gap."""
        sample = self._close() if self._syncs else None
        self._motions.clear()
        self._places.clear()
        self._settled = False
        self._syncs += 1
        return sample

    def _close(self) -> Sample | None:
        motions, places, index = self._motions, self._places, self._syncs - 1
        if max(len(motions), len(places)) > 1 and self._risked is not None:
            self.doubt = f"answers to SYNC came a cycle late since sample {self._risked}"
        self._owed_motions = max(0, self._owed_motions + 1 - len(motions))
        self._owed_places = max(0, self._owed_places + 1 - len(places))
        good = len(motions) == len(places) == 1 and motions[0].velocity == places[0].velocity
        agreed, self._agreed = self._agreed, motions[0].velocity if good else None
        proven = good and agreed is not None and agreed != self._agreed
        if proven and min(self._owed_motions, self._owed_places) == 0:
            self._owed_motions = self._owed_places = 0  # the other kind is in step: what is owed was lost
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
        return Sample(index, motion.statusword, motion.velocity, motion.torque, place.position)
