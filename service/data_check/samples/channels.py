"""A channel that is constant while the axis moves: not connected, last value held, or zero."""

import numpy as np

from service.data_check.finding import Finding, named
from service.data_check.record import AxisRecords, Record
from service.model.recording import Array

HOLD = 0.02  # s: shorter holds have no effect below 20 Hz
LIKELY = 1e-6  # probability of a run of equal values in one record: below, the run is a hold


def frozen(axis: AxisRecords) -> list[Finding]:
    """Channels with one value only, or with a run of equal values that quantisation does not explain."""
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
    """Length in s of the longest run of equal values, 0 if quantisation of the channel explains it.

    With a fraction p of equal neighbours, the expected number of runs of r equal values among n is n p^r. In a channel
    with coarse steps the motion also gives runs, of similar length. A value held repeatedly is a limit (`clipping`).
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
