"""Position, velocity and set-point of an axis compared: signs, units, scale, delay.

The slope of position over velocity (`kinematics`) shows that the two differ. The commanded offset velocity shows which
of them is wrong, or both. Without a commanded velocity (free trajectories), only the two can be compared.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from service.data_check.finding import Code, Finding, named
from service.data_check.mechanics.kinematics import Slope
from service.data_check.record import AxisRecords, Record, spread
from service.data_check.units import motion_unit

GAIN = 0.005  # both channels come from one sensor: except for rounding they agree to 1e-4; J gets the same error
FOLLOWS = 0.06  # of the commanded speed: a soft loop settles within it, and ripple changes the mean
SURE = 5.0  # standard errors
DELAY = 0.5e-3  # s; a speed computed from differences of positions is half a sample late

Channel = Literal["position", "velocity", "both"]


@dataclass(frozen=True)
class Commanded:
    """Mean velocity of a record over the commanded one, and the possible error by rounding."""

    record: Record
    gain: float
    error: float


def commanded(axis: AxisRecords) -> tuple[Commanded, ...]:
    """Values for the records that move in one direction over complete periods."""
    found: list[Commanded] = []
    for record in axis.those(lambda record: record.turns and record.spec.periodic):
        steady = record.spec.offset_velocity
        rounding = record.steps["velocity"] / 2 / abs(steady)
        found.append(Commanded(record, float(np.mean(record.velocity)) / steady, rounding))
    return tuple(found)


def motion(axis: AxisRecords, slopes: Sequence[Slope], followed: Sequence[Commanded]) -> list[Finding]:
    """All findings about the motion of an axis."""
    speed = {one.record.id: one for one in followed}
    found: dict[tuple[Code, Channel, str | None], list[tuple[str, float]]] = {}
    # a soft loop, or one with ripple, has a different error in each sweep; a wrong scale is the same in all
    differ = min(spread(np.array([one.gain for one in followed])), FOLLOWS)
    judged: set[str] = set()
    for slope in slopes:
        kind = _of_slope(axis, slope, speed.get(slope.record.id))
        if kind is not None:
            judged.add(slope.record.id)
            found.setdefault(kind[0], []).append((slope.record.id, kind[1]))
    for one in followed:
        if one.record.id not in judged and abs(one.gain - 1) > FOLLOWS + one.error + differ:
            kind = _kind(axis, one.gain, "both")
            found.setdefault(kind, []).append((one.record.id, one.gain))
    return [_finding(axis, *kind, rows) for kind, rows in found.items()] + _delay(axis, slopes)


def _of_slope(
    axis: AxisRecords, slope: Slope, speed: Commanded | None
) -> tuple[tuple[Code, Channel, str | None], float] | None:
    """What is wrong between position and velocity of a record, and the factor; None if both are correct."""
    gain = slope.gain
    if gain == 0 or abs(gain - 1) <= GAIN + SURE * slope.gain_error:
        return None
    if speed is not None and abs(gain * speed.gain - 1) > abs(speed.gain - 1):  # velocity is nearer to the command
        return _kind(axis, gain, "position"), gain
    if speed is None and gain > 1 and motion_unit(axis, gain, velocity=False) is not None:
        return _kind(axis, gain, "position"), gain
    return _kind(axis, 1 / gain, "velocity"), 1 / gain


def _kind(axis: AxisRecords, gain: float, channel: Channel) -> tuple[Code, Channel, str | None]:
    if abs(gain + 1) < 0.1:
        signs: dict[Channel, Code] = {"position": "position_sign", "velocity": "velocity_sign", "both": "motion_sign"}
        return signs[channel], channel, None
    unit = motion_unit(axis, gain, velocity=channel == "velocity")
    if unit is not None:
        return ("velocity_unit" if channel == "velocity" else "position_unit"), channel, unit
    return ("motion_scale" if channel == "both" else "velocity_scale"), channel, None


def _finding(
    axis: AxisRecords, code: Code, channel: Channel, unit: str | None, rows: Sequence[tuple[str, float]]
) -> Finding:
    ids, value = tuple(name for name, _ in rows), float(np.median([gain for _, gain in rows]))
    what = "position and velocity" if channel == "both" else channel
    against = {
        "position": "what the integral of velocity says",
        "velocity": "the slope of position",
        "both": "what was commanded",
    }[channel]
    where, limit = f"{axis.joint}, {named(ids)}", FOLLOWS if channel == "both" else GAIN
    if code in ("position_sign", "velocity_sign", "motion_sign"):
        sentence = f"{where}: {what} runs against {against} (factor {value:.4g})."
        action = f"Reverse the sign of {what}" + (
            ", or check that the recording belongs to this sweep." if channel == "both" else "."
        )
    elif unit is not None:
        sentence = f"{where}: {what} is {value:.5g} times {against}, as if it were in {unit}."
        action = f"Convert {what} to SI on the joint side."
    else:
        sentence = f"{where}: {what} is {value:.5g} times {against}, limit 1 +- {limit:g}."
        action = (
            "Check gear ratio and set-points, and that the recording belongs to this sweep."
            if channel == "both"
            else f"Correct the scale of {what}, or the sample rate."
        )
    return Finding(code, "wrong", axis.joint, ids, value, limit, sentence, action)


def _delay(axis: AxisRecords, slopes: Sequence[Slope]) -> list[Finding]:
    """Delay (or advance) of velocity with respect to position, if several records, or one clearly, show it."""
    samples = 0.75
    shown = [(slope, slope.delay) for slope in slopes if slope.delay is not None and slope.gain > 0]
    late = [
        (slope.record.id, delay)
        for slope, delay in shown
        if abs(delay) > max(DELAY, samples / slope.record.rate) + SURE * slope.delay_error
    ]
    if 2 * len(late) <= len(shown):
        return []
    ids, value = tuple(name for name, _ in late), float(np.median([delay for _, delay in late]))
    limit = max(DELAY, samples / shown[0][0].record.rate)
    word = "late against" if value > 0 else "ahead of"
    return [
        Finding(
            "channel_delay", "wrong", axis.joint, ids, value, limit,
            f"{axis.joint}, {named(ids)}: velocity is {1e3 * abs(value):.3g} ms {word} position, limit "
            f"{1e3 * limit:.3g} ms.",
            "Record both channels at one instant, or take the delay of the velocity filter out (`sweepid channels`).",
        )
    ]  # fmt: skip
