r"""Effort with a delay of several milliseconds with respect to motion.

A delay D rotates the impedance of each line by an angle proportional to frequency, Z = (i w J + mu) exp(-i w D). Delays
up to about 2 ms come from physics and filters, which the diagnosis separates. Here D is only reported if it is
large, explains the lines, and a spring does not:  Z = i w J / (1 - (w/w0)^2 + i w c) + mu.
"""

from collections.abc import Sequence

import numpy as np

from service.data_check.finding import Finding, named
from service.data_check.mechanics.response import Response
from service.data_check.record import AxisRecords
from service.identification.spectra.frequency_response import Complex
from service.model.recording import Array

DELAYS = np.arange(-30e-3, 30.25e-3, 0.25e-3)  # s
SPRINGS = np.geomspace(4.0, 60.0, 60)  # Hz
DAMPING = (0.02, 0.1)


def effort_delay(axis: AxisRecords, found: Sequence[Response]) -> list[Finding]:
    """At most one finding, from all records with at least two lines."""
    limit = 5e-3  # s
    some = [one for one in found if len(one.frequency) > 1]
    if not some:
        return []
    late = [np.exp(-2j * np.pi * DELAYS[:, None] * one.frequency) for one in some]
    delays = np.sum([_misfit(one, turn, turn) for one, turn in zip(some, late, strict=True)], axis=0)
    best = int(np.argmin(delays))
    value = float(DELAYS[best])
    # 0.25 of the misfit without delay: a smaller misfit confirms the delay
    if abs(value) < limit or delays[best] > 0.25 * float(delays[np.argmin(np.abs(DELAYS))]):
        return []
    sprung = [_springs(one.frequency) for one in some]
    springs = np.sum([_misfit(one, turn, np.ones_like(turn)) for one, turn in zip(some, sprung, strict=True)], axis=0)
    if springs.min() < 2 * delays[best]:
        return []
    ids = tuple(one.record.id for one in some)
    word = "late against" if value > 0 else "ahead of"
    return [
        Finding(
            "channel_delay", "wrong", axis.joint, ids, value, limit,
            f"{axis.joint}, {named(ids)}: effort is {1e3 * abs(value):.3g} ms {word} velocity at all lines, limit "
            f"{1e3 * limit:.3g} ms.",
            "Record effort and velocity at one instant, or take the filters' delay out (`sweepid channels`).",
        )
    ]  # fmt: skip


def _springs(frequency: Array) -> Complex:
    """Factors (s, l) of i w J for an inertia behind a spring, for all frequencies and dampings."""
    ratio = frequency / np.repeat(SPRINGS, len(DAMPING))[:, None]
    damping = np.tile(DAMPING, len(SPRINGS))[:, None]
    return 1 / (1 - ratio**2 + 2j * damping * ratio)


def _misfit(one: Response, on_inertia: Complex, on_friction: Complex) -> Array:
    """Weighted sum of squares (m,) of the fit of J and mu to each record; their columns are i w and 1, times (m, l)."""
    # 0.02 of Z: other errors of the rigid model
    weight = 1 / np.hypot(one.error, 0.02 * np.abs(one.impedance))
    a, b = 2j * np.pi * one.frequency * on_inertia * weight, on_friction * weight
    wanted = one.impedance * weight
    aa, bb, ab = np.sum(np.abs(a) ** 2, -1), np.sum(np.abs(b) ** 2, -1), np.sum((a.conj() * b).real, -1)
    az, bz = np.sum((a.conj() * wanted).real, -1), np.sum((b.conj() * wanted).real, -1)
    explained = (bb * az**2 - 2 * ab * az * bz + aa * bz**2) / (aa * bb - ab**2)
    return np.asarray(np.sum(np.abs(wanted) ** 2) - explained, dtype=float)
