"""Consistency of time, sample rate and measured window.

The reader of a bundle rejects gaps and a wrong rate; this check finds jitter, and errors in data from other sources.
"""

import numpy as np

from service.data_check.finding import Finding, named
from service.data_check.record import AxisRecords
from service.model.recording import Sweep

SINGLE = float(np.finfo(np.float32).eps)  # time may have been stored in 32 bits


def clock(axis: AxisRecords, sweeps: tuple[Sweep, ...]) -> list[Finding]:
    """One finding of each kind, with all sweeps that show it. `sweeps`: all of the axis, also short ones."""
    gap = 1.5  # samples
    jitter = 0.1  # of a sample, RMS: at 1 kHz and 5 Hz a phase error of 0.003 rad per sample
    kinds: dict[str, list[tuple[str, float]]] = {"gap": [], "rate": [], "jitter": [], "window": []}
    for sweep in sweeps:
        spec, time = sweep.spec, sweep.recording.time
        if len(time) < 3:
            continue
        steps = np.diff(time) * spec.sample_rate
        line = np.polynomial.Polynomial.fit(np.arange(len(time)), time, 1)
        off = float(np.std((time - line(np.arange(len(time)))) * spec.sample_rate))
        jumps = bool(steps.max() > gap or steps.min() <= 0)
        if jumps:
            kinds["gap"].append((spec.id, float(np.abs(steps).max())))
        # 1e-3 relative: shifts a line of 5 Hz by a twentieth of a bin in 10 s
        elif abs(float(np.mean(steps)) - 1) > 1e-3:
            kinds["rate"].append((spec.id, spec.sample_rate / float(np.mean(steps))))
        elif off > max(jitter, 2 * SINGLE * float(time[-1]) * spec.sample_rate):
            kinds["jitter"].append((spec.id, off))
        end = spec.measure_from + (spec.period or 0.0) * (spec.periods or 0)
        if end > (len(time) + 0.5) / spec.sample_rate:
            kinds["window"].append((spec.id, end))
    texts = {
        "gap": ("time jumps by up to {0:.3g} samples", gap, "Export again without gaps, or cut the record before it."),
        "rate": ("time runs at {0:.6g} Hz, not as sample_rate says", None, "Correct sample_rate or the time column."),
        "jitter": ("samples are off their grid by {0:.2g} of a sample (RMS)", jitter, "Record on the drive's clock."),
        "window": ("the measured window ends at {0:.4g} s, after the record", None, "Correct measure_from or periods."),
    }
    return [
        Finding(
            "clock", "wrong", axis.joint, ids := tuple(name for name, _ in found), worst := max(v for _, v in found),
            texts[kind][1], f"{axis.joint}: {texts[kind][0].format(worst)} ({named(ids)}).", texts[kind][2],
        )
        for kind, found in kinds.items() if found
    ]  # fmt: skip
