"""Clipping: the extreme value of a channel occurs much more often than the values next to it.

If noise is added before a limit, samples accumulate on the limit. Without a limit, the extreme value of a continuous
channel occurs once, and that of a quantised one about as often as its neighbour. If the axis hardly moves at the
extreme, the neighbouring value also occurs often, and there is no limit: a round top fills the last steps equally.
"""

import numpy as np

from service.data_check.finding import Finding, named
from service.data_check.probabilities import poisson_quantile
from service.data_check.record import AxisRecords
from service.model.recording import Array

SHARE = 0.003  # of the window
CHANCE = 1e-6  # probability that the last step of a parabola has so many samples


def clipping(axis: AxisRecords) -> list[Finding]:
    """One finding per channel, with the fraction of samples on the limit."""
    findings: list[Finding] = []
    for name, samples in axis.channels(("effort", "velocity"), lambda record: record.spec.moves):
        found: list[tuple[str, float, float]] = []
        for record, values in samples:
            for sign in (1.0, -1.0):
                share = _on_limit(sign * values, record.steps[name])
                if share > 0:
                    found.append((record.id, share, sign * float((sign * values).max())))
        # a limit applies to all sweeps: a few samples of one sweep may be there by chance
        # 0.02 of the window, in a single sweep
        if len({sweep for sweep, _, _ in found}) > 1 or any(share > 0.02 for _, share, _ in found):
            ids = tuple(dict.fromkeys(sweep for sweep, _, _ in found))
            _, share, limit = max(found, key=lambda one: one[1])
            of_rated = f", {100 * abs(limit) / axis.axis.rated_effort:.3g} % of rated effort" * (name == "effort")
            findings.append(
                Finding(
                    "clipped", "wrong", axis.joint, ids, share, SHARE,
                    f"{axis.joint}: {name} ends at {limit:.6g}{of_rated}: up to {100 * share:.2g} % of the samples lie "
                    f"exactly there ({named(ids)}).",
                    "Measure with smaller amplitudes, or raise the limit or the range of the channel.",
                )
            )  # fmt: skip
    return findings


def _on_limit(values: Array, step: float) -> float:
    """Fraction of the window on the largest value, 0 if that is no limit."""
    top = float(values.max())
    width = float(np.ptp(values))
    if width == 0:
        return 0.0
    grain = step if step > 1e-5 * width else 1e-5 * width
    on = int(np.count_nonzero(values > top - 0.5 * grain))
    beside = int(np.count_nonzero((values > top - 1.5 * grain) & (values <= top - 0.5 * grain)))
    if step > 0.02 * width:  # few steps: a sine stays on its last one
        beside = max(beside, on // 2)
    near = np.count_nonzero((values > top - 3.5 * grain) & (values <= top - 0.5 * grain)) / 3
    # 3.0 times the mean of the next three steps: last step of a parabola, 1 against (sqrt(4) - 1) / 3
    by_chance = poisson_quantile(1 - CHANCE, 3.0 * max(float(near), 1.0))
    # 10 samples on the extreme value
    enough = on > max(10, SHARE * len(values), by_chance)
    # 4.0 times the number on the neighbouring step, or within the same distance
    return on / len(values) if enough and on > 4.0 * beside else 0.0
