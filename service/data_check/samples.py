"""Findings about the samples themselves: clock, frozen and clipped channels, coarse steps, spikes, lost samples.

The reader of a bundle rejects gaps and a wrong rate; `clock` finds jitter, and errors in data from other sources.

Clipping. If noise is added before a limit, samples accumulate on the limit. Without a limit, the extreme value of a
continuous channel occurs once, and that of a quantised one about as often as its neighbour. If the axis hardly moves
at the extreme, the neighbouring value also occurs often, and there is no limit: a round top fills the last steps
equally.

Steps. Drives give torque in per mille of the rated torque (CiA 402, object 6077). This is a usual step; noise averages
it out. An 8-bit channel over both directions of the rated torque has steps eight times as large.

Spikes. The deviation of a sample is computed from the median of seven samples around it, which preserves steps and
ramps. Noise of standard deviation s gives a deviation of about s. Physical effects in a drive last longer than two
samples, or their pulse is no larger than the deviations near it.

Lost samples. While an axis moves in one direction, position changes by v dt per sample; each lost sample adds the same
amount. The limit includes the change of velocity between two samples. If samples are missing, the sines of velocity
also jump to a later phase; if not, the encoder lost counts.
"""

import numpy as np
from scipy.ndimage import maximum_filter, median_filter, minimum_filter

from service.data_check.finding import Code, DataFinding, named
from service.data_check.probabilities import poisson_quantile
from service.data_check.record import AxisRecords, Record, spread
from service.model import Array, Indices, Mask, Sweep

SINGLE = float(np.finfo(np.float32).eps)  # time may have been stored in 32 bits


def clock(axis: AxisRecords, sweeps: tuple[Sweep, ...]) -> list[DataFinding]:
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
        DataFinding(
            "clock", "wrong", axis.joint, ids := tuple(name for name, _ in found), worst := max(v for _, v in found),
            texts[kind][1], f"{axis.joint}: {texts[kind][0].format(worst)} ({named(ids)}).", texts[kind][2],
        )
        for kind, found in kinds.items() if found
    ]  # fmt: skip


HOLD = 0.02  # s: shorter holds have no effect below 20 Hz
LIKELY = 1e-6  # probability of a run of equal values in one record: below, the run is a hold


def frozen(axis: AxisRecords) -> list[DataFinding]:
    """Channels with one value only, or with a run of equal values that quantisation does not explain."""
    findings: list[DataFinding] = []
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
                DataFinding(
                    "frozen", "wrong", axis.joint, tuple(dead), None, None,
                    f"{axis.joint}: {name} has one and the same value in {named(dead)}, while the axis moves.",
                    f"Check that the channel {name} is recorded, and from this axis.",
                )
            )  # fmt: skip
        if held:
            ids, longest = tuple(sweep for sweep, _ in held), max(length for _, length in held)
            findings.append(
                DataFinding(
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


SHARE = 0.003  # of the window
CHANCE = 1e-6  # probability that the last step of a parabola has so many samples


def clipping(axis: AxisRecords) -> list[DataFinding]:
    """One finding per channel, with the fraction of samples on the limit."""
    findings: list[DataFinding] = []
    for name, samples in axis.channels(("effort", "velocity"), lambda record: record.spec.moves):
        found: list[tuple[str, float, float]] = []
        for record, values in samples:
            for sign in (1.0, -1.0):
                share = _on_limit(sign * values, record.steps[name])
                stands = name == "velocity" and (sign * values).max() == 0  # one way only
                if share > 0 and not stands:
                    found.append((record.id, share, sign * float((sign * values).max())))
        # a limit applies to all sweeps: a few samples of one sweep may be there by chance
        # 0.02 of the window, in a single sweep
        if len({sweep for sweep, _, _ in found}) > 1 or any(share > 0.02 for _, share, _ in found):
            ids = tuple(dict.fromkeys(sweep for sweep, _, _ in found))
            _, share, limit = max(found, key=lambda one: one[1])
            of_rated = f", {100 * abs(limit) / axis.axis.rated_effort:.3g} % of rated effort" * (name == "effort")
            findings.append(
                DataFinding(
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


def quantisation(axis: AxisRecords) -> list[DataFinding]:
    """One finding per channel."""
    findings: list[DataFinding] = []
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
                DataFinding(
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


WIDTH = 7  # samples of the median
NEAR = 3  # samples within which a pulse of motion is visible in effort and velocity
LONGEST = 3  # consecutive samples


def spikes(axis: AxisRecords) -> list[DataFinding]:
    """One finding per channel: the number of spikes, and the largest one."""
    findings: list[DataFinding] = []
    for name, samples in axis.channels():
        found: list[tuple[str, int, float]] = []
        for record, values in samples:
            floor = _floor(axis, record, name, values)
            off = _off(values)
            # 12.0 robust standard deviations: noise and impacts in backlash stay below
            single = _single(values, off, max(12.0 * _noise(values, off), 3 * record.steps[name], floor))
            if single.size and name != "position":
                single = single[~_moved(record, name, single)]
            if single.size:
                found.append((record.id, int(single.size), float(np.abs(off[single]).max())))
        if found:
            ids = tuple(sweep for sweep, _, _ in found)
            count, largest = sum(number for _, number, _ in found), max(size for _, _, size in found)
            findings.append(
                DataFinding(
                    "spikes", "wrong", axis.joint, ids, largest, None,
                    f"{axis.joint}: {name} has {count} single sample{'s' * (count > 1)} off the course of "
                    f"those around, by up to {largest:.4g} ({named(ids)}).",
                    "Look for lost frames, loose shields or faults of the encoder, and record again.",
                )
            )  # fmt: skip
    return findings


def _off(values: Array) -> Array:
    """Deviation from the median of the samples around."""
    return values - np.asarray(median_filter(values, WIDTH, mode="nearest"), dtype=float)


def _noise(values: Array, off: Array) -> float:
    """Standard deviation from values and deviations: on steep parts the median is the sample, the deviation 0."""
    return max(spread(off), spread(np.diff(values, 2)) / np.sqrt(6))


def _off_course(values: Array, first: int, last: int) -> float:
    """Largest distance from the cubic through three samples on either side; for a smooth short peak it is small."""
    around = np.r_[max(first - 3, 0) : first, last + 1 : min(last + 4, len(values))]
    course = np.polynomial.Polynomial.fit(around, values[around], min(3, len(around) - 1))
    group = np.arange(first, last + 1)
    return float(np.abs(values[group] - course(group)).max())


def _moved(record: Record, name: str, single: Indices) -> Mask:
    """Where the other of effort and velocity also has the pulse, or velocity has a kink or passes standstill: backlash
    closes, a load breaks loose, or dry friction turns.
    """
    pulse = 8.0  # robust standard deviations
    other = "velocity" if name == "effort" else "effort"
    off = np.abs(_off(getattr(record, other)))
    beside = np.asarray(maximum_filter(off, 2 * NEAR + 1, mode="nearest"), dtype=float)[single]
    shown = beside > max(pulse * spread(off), 2 * record.steps[other])
    if name == "velocity":
        return shown | _way(record, single)
    bent = np.abs(np.diff(record.velocity, 2, prepend=record.velocity[0], append=record.velocity[-1]))
    kinked = np.asarray(maximum_filter(bent, 2 * NEAR + 1, mode="nearest"), dtype=float)[single]
    least = max(pulse * spread(bent), 4 * record.steps["velocity"])
    # before and after the record the axis may stand
    low, high = (
        np.asarray(extreme(record.velocity, 2 * NEAR + 1, mode="constant"), dtype=float)[single]
        for extreme in (minimum_filter, maximum_filter)
    )
    return shown | (kinked > least) | ((low <= 0) & (high >= 0) & (high - low > least))


def _way(record: Record, single: Indices) -> Mask:
    """Where position changes by the integral of a velocity pulse."""
    first, last = np.maximum(single - NEAR, 0), np.minimum(single + NEAR, record.count - 1)
    usual = np.asarray(median_filter(record.velocity, 2 * WIDTH, mode="nearest"), dtype=float)[single]
    gone = record.position[last] - record.position[first] - usual * (last - first) / record.rate
    off = _off(record.velocity) / record.rate
    counted, size = (np.concatenate([[0.0], np.cumsum(part)]) for part in (off, np.abs(off)))
    missed = np.abs(gone - (counted[last + 1] - counted[first]))
    return missed < (size[last + 1] - size[first]) / 2


def _floor(axis: AxisRecords, record: Record, name: str, values: Array) -> float:
    """Deviation below which a spike changes nothing."""
    if name == "effort":
        # 0.02 of rated effort: smaller spikes do not change the result
        return 0.02 * axis.axis.rated_effort
    fastest = axis.fastest or 3 * float(np.std(record.velocity))
    rounding = 3 * SINGLE * float(np.abs(values).max())
    # 0.1 of the largest commanded speed
    return max(0.1 * fastest if name == "velocity" else 5 * fastest / record.rate, rounding)


def _single(values: Array, off: Array, limit: float) -> Indices:
    """Samples beyond the limit: at most `LONGEST` consecutive ones, isolated, after which the value returns."""
    size = np.abs(off)
    beyond = np.flatnonzero(size > limit)
    if not beyond.size or limit == 0:
        return beyond[:0]
    kept: list[int] = []
    for group in np.split(beyond, np.flatnonzero(np.diff(beyond) > 1) + 1):
        first, last = int(group[0]), int(group[-1])
        near = np.concatenate([size[max(first - 11, 0) : max(first - 1, 0)], size[last + 2 : last + 12]])
        near = near[near <= limit] if near.size and np.count_nonzero(near > limit) <= 2 else near
        before, after = values[max(first - 2, 0)], values[min(last + 2, len(values) - 1)]
        returns = abs(after - before) < size[group].max() / 2
        alone = last - first < LONGEST and _off_course(values, first, last) > limit
        # 3.0 times the largest other deviation within 20 samples
        if returns and alone and (not near.size or size[group].max() > 3.0 * near.max()):
            kept.extend(range(first, last + 1))
    return np.array(kept, dtype=np.intp)


LEAST = 0.7  # samples


def lost_samples(axis: AxisRecords) -> list[DataFinding]:
    """One finding of each kind, with the largest number of samples lost in one place."""
    found: dict[Code, list[tuple[str, float]]] = {}
    for record in axis.those(lambda record: record.turns):
        lost, at = _lost(record)
        if lost > 0:
            late = _phases_jump(record, at, lost)
            found.setdefault("time_jump" if late else "lost_counts", []).append((record.id, lost))
    return [_finding(axis, code, rows) for code, rows in found.items()]


def _finding(axis: AxisRecords, code: Code, rows: list[tuple[str, float]]) -> DataFinding:
    ids, most = tuple(name for name, _ in rows), max(lost for _, lost in rows)
    missing = code == "time_jump"
    return DataFinding(
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
