"""Lost samples: time is uniform, but position has a larger step than velocity explains.

While an axis moves in one direction, position changes by v dt per sample; each lost sample adds the same amount. The
limit includes the change of velocity between two samples. If samples are missing, the sines of velocity also jump to a
later phase; if not, the encoder lost counts.
"""

import numpy as np

from service.data_check.finding import Code, Finding, named
from service.data_check.record import AxisRecords, Record, spread
from service.model.recording import Array

LEAST = 0.7  # samples


def lost_samples(axis: AxisRecords) -> list[Finding]:
    """One finding of each kind, with the largest number of samples lost in one place."""
    found: dict[Code, list[tuple[str, float]]] = {}
    for record in axis.those(lambda record: record.turns):
        lost, at = _lost(record)
        if lost > 0:
            late = _phases_jump(record, at, lost)
            found.setdefault("time_jump" if late else "lost_counts", []).append((record.id, lost))
    return [_finding(axis, code, rows) for code, rows in found.items()]


def _finding(axis: AxisRecords, code: Code, rows: list[tuple[str, float]]) -> Finding:
    ids, most = tuple(name for name, _ in rows), max(lost for _, lost in rows)
    missing = code == "time_jump"
    return Finding(
        code, "wrong", axis.joint, ids, most, LEAST,
        f"{axis.joint}, {named(ids)}: position jumps by as much as {most:.3g} samples of its velocity make"
        + (", and the sines go on as much later: samples are missing, though time counts on evenly." if missing
           else ", while the sines go on in phase: the encoder lost counts."),
        "Record again without lost frames; a record is never resampled here." if missing
        else "Look at the encoder, its cable and its supply, and record again.",
    )  # fmt: skip


def _lost(record: Record) -> tuple[float, int]:
    """Largest permanent jump in samples, and the sample before it; 0 if there is none."""
    velocity, position = record.velocity, record.position
    if not (np.all(velocity > 0) or np.all(velocity < 0)):
        return 0.0, 0
    steps = np.diff(position)
    explained = (velocity[1:] + velocity[:-1]) / 2 / record.rate
    off = steps - explained
    off = off - np.median(off)
    rounding = 3 * record.steps["position"] + record.steps["velocity"] / record.rate
    # 15.0 robust standard deviations
    allowed = np.abs(np.diff(velocity)) / record.rate + 15.0 * spread(off) + rounding
    jumps = np.flatnonzero(np.abs(off) > allowed)
    stays = [int(k) for k in jumps if abs(off[max(k - 2, 0) : k + 3].sum()) > allowed[k]]  # a spike returns
    sizes = [(abs(float(off[k] / explained[k])), k) for k in stays]
    return max((one for one in sizes if one[0] > LEAST), default=(0.0, 0))


def _phases_jump(record: Record, at: int, lost: float) -> bool:
    """Whether velocity after the jump has a later phase; if there are no lines, yes."""
    longer = 1.5  # times the jump at the velocity next to it: largest delay of the sines that is tried
    lines = [sine.frequency for sine in record.spec.sines]
    if not lines:
        return True
    time = np.arange(record.count) / record.rate
    before, after = time <= time[at], time > time[at]
    tried = np.linspace(-longer * lost, longer * lost, 61) / record.rate  # counts may also be lost backwards
    left = [_left(record.velocity, lines, time + late * after) for late in (0.0, *tried)]
    enough = min(np.count_nonzero(before), np.count_nonzero(after)) > 4 * len(lines)
    # 0.5 of the residual of velocity without a jump
    return not enough or min(left[1:]) < 0.5 * left[0]


def _left(velocity: Array, lines: list[float], time: Array) -> float:
    """Sum of squares of the residual of a fit of offset and lines."""
    angles = [2 * np.pi * line * time for line in lines]
    columns = np.stack([np.ones_like(time), *(wave(angle) for angle in angles for wave in (np.cos, np.sin))], -1)
    rest = velocity - columns @ np.linalg.lstsq(columns, velocity, rcond=None)[0]
    return float(rest @ rest)
