"""Quantisation of a channel: steps too large for the effects in a sweep.

Drives give torque in per mille of the rated torque (CiA 402, object 6077). This is a usual step; noise averages it
out. An 8-bit channel over both directions of the rated torque has steps eight times as large.
"""

import numpy as np

from service.data_check.finding import Finding, named
from service.data_check.record import AxisRecords, Record


def quantisation(axis: AxisRecords) -> list[Finding]:
    """One finding per channel."""
    findings: list[Finding] = []
    # 0.0025 of rated effort
    # 0.05 of the largest commanded speed
    # 0.02 of the travel in the window
    for name, limit, of in (
        ("effort", 0.0025, "rated effort"),
        ("velocity", 0.05, "the fastest commanded velocity"),
        ("position", 0.02, "the way of a sweep"),
    ):
        found: list[tuple[str, float]] = []
        for record in axis.those(lambda record: record.spec.moves):
            if name != "effort" and not record.turns:  # a slow axis near standstill has few steps
                continue
            whole = _whole(axis, record, name)
            step = record.steps[name] / whole if whole else 0.0
            if step > limit:
                found.append((record.id, step))
        if found:
            ids, value = tuple(sweep for sweep, _ in found), float(np.median([step for _, step in found]))
            findings.append(
                Finding(
                    "coarse_steps", "wrong", axis.joint, ids, value, limit,
                    f"{axis.joint}: {name} comes in steps of {100 * value:.3g} % of {of}, limit {100 * limit:.3g} % "
                    f"({named(ids)}).",
                    f"Record {name} with more bits, or scale the channel to the range that the sweeps use.",
                )
            )  # fmt: skip
    return findings


def _whole(axis: AxisRecords, record: Record, name: str) -> float:
    if name == "effort":
        return axis.axis.rated_effort
    return record.peak if name == "velocity" else float(np.ptp(record.position))
