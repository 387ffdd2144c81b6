"""Samples lost on the way: time goes on evenly, but position steps by more than velocity explains.

Where an axis turns one way, position goes on by v dt in a sample; each lost one adds as much. What the change of
velocity between two samples may add is allowed for.
"""

import numpy as np

from service.data_check.finding import Finding, named
from service.data_check.record import AxisRecords, Record, spread

FAR = 15.0  # robust standard deviations
LEAST = 0.7  # samples


def lost_samples(axis: AxisRecords) -> list[Finding]:
    """One finding with the number of samples lost at most in one place."""
    found = [(record.id, lost) for record in axis.those(lambda record: record.turns) if (lost := _lost(record)) > 0]
    if not found:
        return []
    ids, most = tuple(name for name, _ in found), max(lost for _, lost in found)
    return [
        Finding(
            "lost_samples", "wrong", axis.joint, ids, most, LEAST,
            f"{axis.joint}, {named(ids)}: position jumps by as much as {most:.3g} samples of its velocity make: "
            "samples are missing, or the encoder lost counts.",
            "Record again without lost frames; a record is never resampled here.",
        )
    ]  # fmt: skip


def _lost(record: Record) -> float:
    """Largest jump in samples, 0 where there is none that stays."""
    velocity, position = record.velocity, record.position
    if not (np.all(velocity > 0) or np.all(velocity < 0)):
        return 0.0
    steps = np.diff(position)
    explained = (velocity[1:] + velocity[:-1]) / 2 / record.rate
    off = steps - explained
    off = off - np.median(off)
    rounding = 3 * record.steps["position"] + record.steps["velocity"] / record.rate
    allowed = np.abs(np.diff(velocity)) / record.rate + FAR * spread(off) + rounding
    jumps = np.flatnonzero(np.abs(off) > allowed)
    stays = [k for k in jumps if abs(off[max(k - 2, 0) : k + 3].sum()) > allowed[k]]  # a spike goes back
    sizes = [abs(float(off[k] / explained[k])) for k in stays]
    return max((size for size in sizes if size > LEAST), default=0.0)
