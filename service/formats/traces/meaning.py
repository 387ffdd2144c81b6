"""What the channels of an axis mean in SI on the joint side, where neither mapping nor file tells: motion decides.

Speed is the derivative of position. So the ratio of the two tells a speed's unit, and on which side of the gear it was
measured; two speeds, or a motor's speed and the axis' position, tell the gear ratio. A torque in N m is on the side of
the speed. What was found this way is told, and the mapping overrules it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from service import BadInput
from service.formats.traces.mapping import SourceColumn
from service.formats.traces.units import QUANTITIES, measures, quantity_of, to_si
from service.model import Array

FITS = math.log(1.15)  # a ratio of speeds may be off by 15 %; units differ by more
_SHOWN = ("", "velo", "velo motor")  # no unit, or the one that a control shows


@dataclass(frozen=True, slots=True)
class SourceChannel:
    """A column as it is in the file."""

    column: SourceColumn
    unit: str
    values: Array
    named: bool = True  # by the mapping; without any unit it is SI then


@dataclass(slots=True)
class KnownTrain:
    """What is known of the axis; what the motion shows is filled in. `gear_ratio`: motor rad per joint rad (m)."""

    prismatic: bool | None = None
    gear_ratio: float | None = None
    rated_effort: float | None = None
    torque_constant: float | None = None
    fixed: bool = False  # the sign of the gear ratio is that of a robot's file
    notes: list[str] = field(default_factory=list[str])
    on_motor: bool = False  # the speed was measured on the motor

    def tell(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)


def find_kind(train: KnownTrain, channels: Mapping[str, SourceChannel], time: Array) -> None:
    """Whether the axis slides, and its gear ratio, where they are not known."""
    if train.prismatic is None:
        train.prismatic = _slides(train, channels, time)
    if train.gear_ratio is None:
        train.gear_ratio = _gear(train, channels, time)


def scalings(
    train: KnownTrain, channels: Mapping[str, SourceChannel], time: Array, place: str
) -> dict[str, tuple[float, float]]:
    """Scale and offset to SI by column, of those that the mapping does not scale itself."""
    wanted = {name: one for name, one in channels.items() if _open(one)}
    found: dict[str, tuple[float, float]] = {}
    for name in ("position", "set_position", "load_position"):
        if name in wanted:
            found[name] = (_way(train, name, wanted[name], channels, time, f"{place} column {name}"), 0.0)
    position = _si(channels, found, "position")
    for name in ("velocity", "velocity_setpoint", "load_velocity"):
        if name in wanted:
            found[name] = (_speed(train, name, wanted[name], position, time, f"{place} column {name}"), 0.0)
    for name in ("effort", "excitation_effort"):
        if name in wanted:
            found[name] = (_effort(train, name, wanted[name], f"{place} column {name}"), 0.0)
    if "temperature" in wanted and wanted["temperature"].unit:
        found["temperature"] = to_si("temperature", wanted["temperature"].unit, False, f"{place} column temperature")
    return found


def _open(one: SourceChannel) -> bool:
    return not one.column.scaled and one.column.unit is None and one.unit != "SI" and bool(one.unit or not one.named)


def _si(channels: Mapping[str, SourceChannel], found: Mapping[str, tuple[float, float]], name: str) -> Array | None:
    if name not in channels:
        return None
    scale, offset = found.get(name, (channels[name].column.scale, channels[name].column.offset))
    return scale * channels[name].values + offset


def slope(position: Array, time: Array, speed: Array, least: float = 0.8) -> float | None:
    """Factor of a speed by which its integral follows position; None where it explains less than `least` of it."""
    way = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(time))])
    way, position = way - way.mean(), position - position.mean()
    power, moved = float(way @ way), float(position @ position)
    if not (power > 0 and moved > 0 and math.isfinite(power * moved)):
        return None
    along = float(way @ position)
    return along / power if along**2 / power / moved > least else None


def _slides(train: KnownTrain, channels: Mapping[str, SourceChannel], time: Array) -> bool:
    for name in ("position", "velocity", "load_velocity", "effort"):
        known = measures(channels[name].unit) if name in channels else None
        if known and known[0] in ("length", "speed", "force", "angle", "angular speed"):
            return known[0] in ("length", "speed", "force")
    found = _shown(train, channels, time) if "position" in channels and channels["position"].unit == "posn" else None
    if found is not None:
        return found
    train.tell("the axis is taken as rotary; --kind, or `kind` of the robot, overrules it")
    return False


def _shown(train: KnownTrain, channels: Mapping[str, SourceChannel], time: Array) -> bool | None:
    """By a control that shows deg with rev/min, and mm with mm/min, of the axis; rev/min of its motor."""
    for name in ("load_velocity", "velocity"):
        if name not in channels:
            continue
        ratio = slope(channels["position"].values, time, channels[name].values)
        gear = abs(train.gear_ratio or 1.0) if channels[name].unit == "velo motor" else 1.0
        for slides, unit, factor in ((True, "mm/min", 1 / 60), (True, "m/min", 1e3 / 60), (False, "rev/min", 6.0)):
            if ratio and _off(factor, ratio * (1.0 if slides else gear)) < FITS:
                kind = "linear" if slides else "rotary"
                train.tell(f"the axis is {kind}: {name} is in {unit} of what position is in")
                return slides
        if ratio and gear != 1 and _off(1e3 * math.tau / 60, ratio * gear) < FITS:
            train.tell(f"the axis is linear: its position is in mm, by the {train.gear_ratio:g} rad/m of the motor")
            return True
    return None


def _gear(train: KnownTrain, channels: Mapping[str, SourceChannel], time: Array) -> float | None:
    """From the speed of the motor in turns and the position of the axis."""
    motor, position = channels.get("velocity"), channels.get("position")
    if motor is None or position is None or not _open(motor):
        return None
    turns, control = (measures(motor.unit) or ("",))[0] == "turns per time", motor.unit == "velo motor"
    kind, known = quantity_of("position", bool(train.prismatic)), measures(position.unit)
    unit = known[1] if known and known[0] == kind else None
    if position.unit == "posn":
        unit = QUANTITIES[kind]["mm" if train.prismatic else "deg"]
    if position.column.scaled:
        unit = position.column.scale
    if unit is None or not (turns or control or (not motor.unit and not train.prismatic)):
        return None
    ratio = slope(position.values * unit, time, motor.values, 0.98)
    if not ratio:
        return None
    if control and train.prismatic and _named(ratio, "speed"):
        train.tell("the motor is linear: gear ratio 1")
        return 1.0
    if not motor.unit and _named(ratio, "angular speed"):
        return None  # a unit of the axis itself
    gear = math.tau / 60 / ratio
    if not train.prismatic and 1 / 1.5 < abs(gear) < 1.5:  # no gear
        return 1.0 if control else None
    short = float(f"{gear:.3g}")
    found = short if abs(short / gear - 1) < 2e-3 else float(f"{gear:.5g}")
    train.tell(f"gear ratio {found:g}: the motor's speed over that of the axis; --gear-ratio overrules it")
    return found


def _way(
    train: KnownTrain, name: str, one: SourceChannel, channels: Mapping[str, SourceChannel], time: Array, place: str
) -> float:
    quantity = quantity_of(name, bool(train.prismatic))
    if one.unit == "posn":
        return QUANTITIES[quantity]["mm" if train.prismatic else "deg"]
    known = measures(one.unit)
    if known and known[0] == "turns":
        if name == "load_position" or train.gear_ratio is None:
            return known[1]
        train.tell(f"{name} in {one.unit} is taken as turns of the motor")
        return known[1] / train.gear_ratio
    if one.unit:
        return to_si(name, one.unit, bool(train.prismatic), place)[0]
    speed = channels.get("velocity")
    stated = measures(speed.unit) if speed and _open(speed) else None
    ratio = slope(one.values, time, speed.values) if speed and stated and "speed" in stated[0] else None
    if stated and ratio:
        fits = {unit: abs(math.log(abs(ratio * factor / stated[1]))) for unit, factor in QUANTITIES[quantity].items()}
        unit = min(fits, key=lambda each: fits[each])
        if fits[unit] < FITS:
            train.tell(f"{name} has no unit; by its speed it is {unit}")
            return QUANTITIES[quantity][unit]
    wide = float(np.ptp(one.values)) if len(one.values) else 0.0
    unit = ("mm" if wide > 20 else "m") if train.prismatic else ("deg" if wide > 3 * math.pi else "rad")
    train.tell(f"{name} has no unit; its range of {wide:.3g} is taken as {unit}")
    return QUANTITIES[quantity][unit]


def _named(scale: float, quantity: str) -> bool:
    """Whether it is the factor of a unit."""
    return min(_off(factor, scale) for factor in QUANTITIES[quantity].values()) < FITS


def _speed(train: KnownTrain, name: str, one: SourceChannel, position: Array | None, time: Array, place: str) -> float:
    """By unit and motion: the joint's, or the motor's divided by the gear ratio."""
    seen = None if position is None else slope(position, time, one.values)
    gear = train.gear_ratio or 1.0
    known, quantity = measures(one.unit), quantity_of(name, bool(train.prismatic))
    units: dict[str, tuple[str, float]]
    if known is not None and known[0] in ("angular speed", "speed", "turns per time"):
        units = {one.unit: known}
    elif one.unit in _SHOWN:
        kinds = (quantity, "turns per time")
        units = {unit: (kind, factor) for kind in kinds for unit, factor in QUANTITIES[kind].items()}
    else:
        return to_si(name, one.unit, bool(train.prismatic), place)[0]
    sides: list[tuple[float, float, str, bool]] = []
    geared = name != "load_velocity" and train.gear_ratio is not None and (gear != 1 or train.prismatic)
    for unit, (kind, factor) in units.items():
        if kind == quantity or (kind == "turns per time" and not train.prismatic):
            sides.append((_off(factor, seen), factor, unit, False))
        if geared and kind != "speed":
            sides.append((_off(factor / abs(gear), seen), factor / gear, unit, True))
    best = min(sides, key=lambda each: each[0], default=None)
    if best is None or seen is None or best[0] > FITS:
        if known and known[0] == quantity:
            return known[1]
        if one.unit in _SHOWN and seen is None and best is not None and name != "velocity":
            return best[1]
        if one.unit == "" and best is not None:
            si = "m/s" if train.prismatic else "rad/s"
            train.tell(f"{name} has no unit and does not follow position: taken as {si}")
            return 1.0
        if len(sides) == 1 and seen is None:
            return sides[0][1]
        if seen is not None and best is not None:
            told = (
                f"unit {one.unit!r} of the file is not a unit of {name} that follows position, which moves {seen:.3g}"
            )
            raise BadInput(place, f"{told} times as fast: give a unit, scale or gear ratio in the mapping")
        return to_si(name, one.unit, bool(train.prismatic), place)[0]
    _, scale, unit, on_motor = best
    if name == "velocity":
        train.on_motor = on_motor
    if on_motor and scale * seen < 0 and train.gear_ratio is not None and name == "velocity" and not train.fixed:
        train.gear_ratio, scale = -train.gear_ratio, -scale
        train.tell(f"the motor turns against the axis: gear ratio {train.gear_ratio:g}")
    if one.unit in _SHOWN or on_motor or known is None or known[0] != quantity:
        train.tell(f"{name}, {one.column.name}: {unit} of the {'motor' if on_motor else 'axis'}, as position moves")
    return scale


def _off(factor: float, seen: float | None) -> float:
    return 0.0 if seen is None else abs(math.log(abs(seen / factor)))


def _effort(train: KnownTrain, name: str, one: SourceChannel, place: str) -> float:
    gear, known = train.gear_ratio or 1.0, measures(one.unit)
    quantity = known[0] if known else ""
    factor, column = known[1] if known else 1.0, one.column.name

    def ask(what: str, option: str) -> BadInput:
        told = f"{column!r} is in {one.unit}: give {what} as --{option.replace('_', '-')} (`{option}` of the axis)"
        return BadInput(place, f"{told}, or a scale in the mapping")

    if quantity == "current":
        if train.torque_constant is None:
            raise ask("the motor's torque constant, N m/A,", "torque_constant")
        train.tell(f"{name}, {column}: {train.torque_constant:g} N m/A of the motor x gear ratio {gear:g}")
        return factor * train.torque_constant * gear
    if quantity == "part":
        if train.rated_effort is None:
            raise ask("the rated torque of the joint, N m (N),", "rated_effort")
        train.tell(f"{name}, {column}: of the rated {train.rated_effort:g} N m (N) of the joint")
        return math.copysign(train.rated_effort, gear) * factor
    if one.unit == "motor Nm":
        if train.gear_ratio is None:
            told = f"{column!r} is the motor's torque: give the gear ratio as --gear-ratio, or in the mapping"
            raise BadInput(place, told)
        return gear
    if quantity == "torque" or (not one.unit and not train.prismatic):
        on_motor = train.on_motor or bool(train.prismatic)
        if on_motor or not one.unit:
            what = one.unit or "without unit, taken as N m"
            train.tell(f"{name}, {column}: {what} of the {'motor' if on_motor else 'axis'}, on the side of the speed")
        return factor * (gear if on_motor else 1.0)
    if not one.unit:
        train.tell(f"{name}, {column}, has no unit; taken as N")
        return 1.0
    return to_si(name, one.unit, bool(train.prismatic), place)[0]
