"""Position, velocity and set-point of an axis compared: signs, units, scale, delay.

The slope of position over velocity shows that the two differ. The commanded offset velocity shows which
of them is wrong, or both. Without a commanded velocity (free trajectories), only the two can be compared.

Over the window

    position(t) = p0 + k W(t) + k D velocity(t),        W = integral of velocity

with k = 1 if the units agree. For a velocity with delay D, W(t) = way(t - D) = way(t) - D v(t), so D is the
coefficient of velocity. Nothing is differentiated, so noise is not amplified.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from service.data_check.finding import Code, DataFinding, named
from service.data_check.record import AxisRecords, Record, spread
from service.model import Array


@dataclass(frozen=True)
class Slope:
    """Result for one record: `gain` k and its error by noise and rounding, `delay` D in s and its error."""

    record: Record
    gain: float
    gain_error: float
    delay: float | None  # None if velocity is nearly constant
    delay_error: float


def slopes(axis: AxisRecords) -> tuple[Slope, ...]:
    """The slopes of all records with enough travel."""
    found = [_slope(record) for record in axis.those(lambda record: record.travels)]
    return tuple(slope for slope in found if slope is not None)


def _slope(record: Record) -> Slope | None:
    velocity, position = record.velocity, record.position - record.position[0]
    # 20.0 steps of the position: minimum travel in a window
    if np.ptp(velocity) == 0 or np.ptp(position) <= 20.0 * record.steps["position"] or np.ptp(position) == 0:
        return None
    way = np.concatenate([[0.0], np.cumsum(velocity[1:] + velocity[:-1]) / 2]) / record.rate
    columns = np.stack([way, velocity, np.ones_like(way)], -1)
    scale = np.array([float(np.ptp(way)), float(np.ptp(velocity)), 1.0])
    unit = columns / scale
    solution = np.linalg.pinv(unit) @ position
    values = np.asarray(solution / scale, dtype=float)
    error = _errors(unit, position - unit @ solution) / scale
    steady = abs(record.spec.offset_velocity)
    rounding = record.steps["velocity"] / 2 / steady if steady else 0.0
    fastest = float(np.abs(velocity).max())
    gain = float(values[0])
    # 0.02 of the maximum: with less variation of velocity, a delay is invisible
    shows_delay = gain != 0 and float(np.std(velocity)) > 0.02 * fastest
    return Slope(
        record,
        gain,
        float(error[0]) + rounding,
        float(values[1]) / gain if shows_delay else None,
        abs(float(error[1]) / gain) if shows_delay else 0.0,
    )


def _errors(columns: Array, rest: Array) -> Array:
    """Standard errors (c,) of least squares with correlated residuals: one sample in twenty counts as independent."""
    covariance = np.linalg.pinv(columns.T @ columns) * float(rest @ rest) / max(len(rest) / 20, 1.0)
    return np.sqrt(np.diag(covariance))


TURN = 2 * np.pi


def motion_unit(axis: AxisRecords, gain: float, *, velocity: bool) -> str | None:
    """The unit in which a position (or velocity) is `gain` times the SI value; None if there is none."""
    close = 0.04  # relative: a wrong unit gives an exact factor
    if gain == 0:
        return None
    ratio = abs(axis.axis.gear_ratio)
    side = {"": 1.0} | ({" on the motor side": ratio} if abs(ratio - 1) > close else {})
    turning = {"rad": 1.0, "degrees": 360 / TURN, "turns": 1 / TURN}
    # a control that treats a linear axis as a rotary one gives degrees
    own = {"mm": 1e3, "degrees": 360 / TURN} if axis.prismatic else turning
    rates = {"/s": 1.0, "/min": 60.0} if velocity else {"": 1.0}
    names = {
        f"{unit}{rate}{where}": factor * per * gear
        for where, gear in side.items()
        for unit, factor in (turning if where else own).items()
        for rate, per in rates.items()
    }
    near = {name: abs(np.log(abs(gain) / factor)) for name, factor in names.items() if abs(factor - 1) > close}
    best = min(near, key=lambda name: near[name], default=None)
    return best if best is not None and near[best] < close else None


def effort_units(axis: AxisRecords) -> dict[str, float]:
    """Units other than SI on the joint side, and their factors."""
    rated, ratio = axis.axis.rated_effort, abs(axis.axis.gear_ratio)
    unit = axis.unit
    return {
        "mN" if axis.prismatic else "N mm": 1e3,
        f"k{unit}": 1e-3,
        "percent of rated effort": 100 / rated,
        "per mille of rated effort": 1000 / rated,
        "parts of rated effort": 1 / rated,
        f"{unit} on the motor side": 1 / ratio,
        "N mm on the motor side": 1e3 / ratio,
    }


def effort_unit(axis: AxisRecords, gain: float, within: float) -> str | None:
    """The unit in which effort is `gain` times that of the model, within a factor exp(`within`); None if none."""
    near = {name: abs(np.log(abs(gain) / factor)) for name, factor in effort_units(axis).items()} if gain else {}
    best = min(near, key=lambda name: near[name], default=None)
    return best if best is not None and near[best] < within else None


GAIN = 0.005  # both channels come from one sensor: except for rounding they agree to 1e-4; J gets the same error
FOLLOWS = 0.06  # of the commanded speed: a soft loop settles within it, and ripple changes the mean
SIGNIFICANT = 5.0  # standard errors
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


def motion(axis: AxisRecords, slopes: Sequence[Slope], followed: Sequence[Commanded]) -> list[DataFinding]:
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
    if gain == 0 or abs(gain - 1) <= GAIN + SIGNIFICANT * slope.gain_error:
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
) -> DataFinding:
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
    return DataFinding(code, "wrong", axis.joint, ids, value, limit, sentence, action)


def _delay(axis: AxisRecords, slopes: Sequence[Slope]) -> list[DataFinding]:
    """Delay (or advance) of velocity with respect to position, if several records, or one clearly, show it."""
    samples = 0.75
    shown = [(slope, slope.delay) for slope in slopes if slope.delay is not None and slope.gain > 0]
    late = [
        (slope.record.id, delay)
        for slope, delay in shown
        if abs(delay) > max(DELAY, samples / slope.record.rate) + SIGNIFICANT * slope.delay_error
    ]
    if 2 * len(late) <= len(shown):
        return []
    ids, value = tuple(name for name, _ in late), float(np.median([delay for _, delay in late]))
    limit = max(DELAY, samples / shown[0][0].record.rate)
    word = "late against" if value > 0 else "ahead of"
    return [
        DataFinding(
            "channel_delay", "wrong", axis.joint, ids, value, limit,
            f"{axis.joint}, {named(ids)}: velocity is {1e3 * abs(value):.3g} ms {word} position, limit "
            f"{1e3 * limit:.3g} ms.",
            "Record both channels at one instant, or take the delay of the velocity filter out (`sweepid channels`).",
        )
    ]  # fmt: skip


def start(axis: AxisRecords) -> list[DataFinding]:
    """Recordings that start at the position of another joint (wrong axis), or at an unknown position (wrong pose)."""
    elsewhere = axis.those(lambda record: abs(_first(record) - record.spec.pose[axis.index]) > _room(record))
    others = {
        joint: [record for record in elsewhere if abs(_first(record) - record.spec.pose[k]) <= _room(record)]
        for k, joint in enumerate(axis.robot.joints)
        if k != axis.index
    }
    joint = max(others, key=lambda name: len(others[name]), default=None)
    theirs = others[joint] if joint is not None and 2 * len(others[joint]) > len(elsewhere) else []
    rest = [record for record in elsewhere if record not in theirs]
    findings: list[DataFinding] = []
    if theirs:
        ids = tuple(record.id for record in theirs)
        findings.append(
            DataFinding(
                "wrong_axis", "wrong", axis.joint, ids, _first(theirs[0]), theirs[0].spec.pose[axis.index],
                f"{axis.joint}, {named(ids)}: position starts at {_first(theirs[0]):.4g}, where {joint} stands; "
                f"{axis.joint} stands at {theirs[0].spec.pose[axis.index]:.4g}.",
                f"Check whether these recordings are of {joint}: the columns, or `axis` in bundle.json.",
            )
        )  # fmt: skip
    if rest:
        ids, worst = tuple(record.id for record in rest), rest[0]
        pose = worst.spec.pose[axis.index]
        degrees = bool(not axis.prismatic and abs(np.radians(pose) - _first(worst)) <= _room(worst))
        findings.append(
            DataFinding(
                "wrong_pose", "wrong", axis.joint, ids, _first(worst), pose,
                f"{axis.joint}, {named(ids)}: position starts at {_first(worst):.4g}, but `pose` says {pose:.4g}"
                f"{' (in degrees?)' * degrees}.",
                "Check `pose`, the zero of the encoder, and that the recording belongs to this sweep and axis.",
            )
        )  # fmt: skip
    return findings


def _first(record: Record) -> float:
    return float(record.sweep.recording.position[0])


def _room(record: Record) -> float:
    """Tolerance, rad (m): a record may start with its window, after a run-up of about the same duration."""
    # 0.02 rad (m): possible difference by zero offsets and rounding of poses
    return 0.02 + float(np.ptp(record.sweep.recording.position)) * (record.spec.excitation != "standstill")


def load_encoder(axis: AxisRecords) -> list[DataFinding]:
    """Slope of load position over motor position, from all records with enough travel; an elastic gear also twists by
    the effort.
    """
    limit = 0.02  # relative
    records = axis.those(lambda record: record.travels and record.load_position is not None)
    motor = np.concatenate([record.position for record in records]) if records else np.zeros(0)
    load = np.concatenate([part for record in records if (part := record.load_position) is not None] or [np.zeros(0)])
    # 0.05 rad (m): with less travel, twist and transmission error dominate
    if not records or np.ptp(motor) < 0.05:
        return []
    effort = np.concatenate([record.effort for record in records])
    columns = np.stack([motor, effort / axis.axis.rated_effort, np.ones(len(motor))], axis=-1)
    solution = np.linalg.lstsq(columns, load)[0]
    gain = float(solution[0])
    # 3.0 times what the line leaves: twist that is no spring's, of a light load on a soft gear
    if abs(gain - 1) <= max(limit, 3.0 * float(np.std(load - columns @ solution)) / float(np.std(motor))):
        return []
    ids = tuple(record.id for record in records)
    unit = motion_unit(axis, gain, velocity=False)
    guess = f", as if one were in {unit}" if unit else ""
    return [
        DataFinding(
            "gear_ratio", "wrong", axis.joint, ids, gain, limit,
            f"{axis.joint}, {named(ids)}: the direct encoder moves {gain:.5g} times as far as the motor's{guess}, "
            f"limit 1 +- {limit:g}.",
            f"Check gear_ratio ({axis.axis.gear_ratio:g}), sign and unit of both encoders.",
        )
    ]  # fmt: skip
