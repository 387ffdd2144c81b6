"""A channel that stands still while the axis moves: one that was never connected, held its last value, or is zero."""

import numpy as np

from service.data_check.finding import Finding, named
from service.data_check.record import AxisRecords, Record
from service.recording import Array

HOLD = 0.02  # s: shorter holds spoil nothing below 20 Hz
LIKELY = 1e-6  # chance of a run of equal values in one record, by which a hold differs from chance


def frozen(axis: AxisRecords) -> list[Finding]:
    """Channels with one value, or with a run of equal values that their own steps do not explain."""
    findings: list[Finding] = []
    moving = axis.channels(chosen=lambda record: record.spec.moves and (record.travels or record.alone))
    for name, samples in moving:
        dead: list[str] = []
        held: list[tuple[str, float]] = []
        for record, values in samples:
            if np.ptp(values) == 0:
                if record.travels or name == "effort":
                    dead.append(record.id)
            elif record.turns and (run := _hold(record, values)) > 0:
                held.append((record.id, run))
        if dead:
            findings.append(
                Finding(
                    "frozen", "wrong", axis.joint, tuple(dead), None, None,
                    f"{axis.joint}: {name} has one and the same value in {named(dead)}, while the axis moves.",
                    f"Check that the channel {name} is recorded, and from this axis.",
                )
            )  # fmt: skip
        if held:
            ids, longest = tuple(sweep for sweep, _ in held), max(length for _, length in held)
            findings.append(
                Finding(
                    "frozen", "wrong", axis.joint, ids, longest, HOLD,
                    f"{axis.joint}: {name} holds one value for {1e3 * longest:.3g} ms in {named(ids)}, while the axis "
                    f"moves; limit {1e3 * HOLD:.3g} ms.",
                    "Record again; look for lost frames between drive and recorder.",
                )
            )  # fmt: skip
    return findings


def _hold(record: Record, values: Array) -> float:
    """Length in s of the longest run of equal values, 0 where the channel's own steps explain it.

    With a share p of equal neighbours, chance makes a run of r equal ones among n with n p^r. In a channel of coarse
    steps the motion makes runs as well, all about as long. A value held again and again is a limit (`clipping`).
    """
    edges = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1, [len(values)]])
    runs = np.diff(edges)
    longest = int(np.argmax(runs))
    held = values[edges[longest]]
    if np.count_nonzero((values[edges[:-1]] == held) & (runs > runs[longest] / 10)) > 2:
        return 0.0
    share = float(len(values) - len(runs) - runs[longest] + 1) / len(values)
    by_chance = np.log(LIKELY / len(values)) / np.log(max(share, 1e-3))
    typical = float(np.sort(runs)[-min(len(runs), 3)])
    limit = max(by_chance, 4 * typical, HOLD * record.rate)
    return float(runs[longest]) / record.rate if runs[longest] > limit else 0.0
